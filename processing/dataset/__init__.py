"""RealFaceDB: the lab's store of whole maps, and the patches that may leave the lab."""

from processing.dataset.about import About, Answers, read_about
from processing.dataset.changes import (
    STORE_FILES,
    add_scan,
    build_store,
    remove_scans,
    verify_store,
)
from processing.dataset.config import PublishConfig
from processing.dataset.protection import narrow_gap
from processing.dataset.publish import RELEASE_FILES, publish
from processing.dataset.release_files import verify_release
from processing.dataset.scan import (
    CHANNELS,
    DatasetError,
    read_head_pose,
    without_people_files,
)
from processing.dataset.store import (
    DATASET,
    NO_SCANS,
    PUBLISHED,
    STORE,
    Scan,
    Store,
    is_release,
    open_store,
)
from processing.dataset.versions import same_version

__all__ = [
    "CHANNELS",
    "DATASET",
    "NO_SCANS",
    "PUBLISHED",
    "RELEASE_FILES",
    "STORE",
    "STORE_FILES",
    "About",
    "Answers",
    "DatasetError",
    "PublishConfig",
    "Scan",
    "Store",
    "add_scan",
    "build_store",
    "is_release",
    "narrow_gap",
    "open_store",
    "publish",
    "read_about",
    "read_head_pose",
    "remove_scans",
    "same_version",
    "verify_release",
    "verify_store",
    "without_people_files",
]
