"""What every command shares: how it ends, its progress bar, its outputs, the one line of facts."""

from lightstage.commands.app import ConsentsOption, JsonFlag, finish, make_app, run_app
from lightstage.commands.lazy import lazy_group
from lightstage.commands.outputs import output_file, output_folder
from lightstage.commands.progress import ProgressCallback, progress_bar, quiet

__all__ = [
    "ConsentsOption",
    "JsonFlag",
    "ProgressCallback",
    "finish",
    "lazy_group",
    "make_app",
    "output_file",
    "output_folder",
    "progress_bar",
    "quiet",
    "run_app",
]
