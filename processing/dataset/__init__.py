"""RealFaceDB: the lab's store of whole maps, and the patches that may leave the lab."""

from processing.dataset.publish import PublishConfig, publish
from processing.dataset.store import (
    CHANNELS,
    DatasetError,
    Scan,
    Store,
    build_store,
    open_store,
    read_head_pose,
)

__all__ = [
    "CHANNELS",
    "DatasetError",
    "PublishConfig",
    "Scan",
    "Store",
    "build_store",
    "open_store",
    "publish",
    "read_head_pose",
]
