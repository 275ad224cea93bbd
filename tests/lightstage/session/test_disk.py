"""What a disk refuses is said with what helps against that, and with nothing else."""

import errno
import os

import pytest

from lightstage.errors import CaptureError
from lightstage.session import SessionPlan, SessionWriter
from lightstage.session.disk import disk_errors

HELPS = {
    errno.ENOSPC: "Free some space",
    errno.EDQUOT: "Free some space",
    errno.EROFS: "Mount it for writing",
    errno.EACCES: "permissions",
    errno.EPERM: "permissions",
    errno.ENOENT: "Was the folder removed",
    errno.ENAMETOOLONG: "Give a shorter name",
    errno.ENOTDIR: "Give another folder",
    errno.ELOOP: "Give another folder",
    errno.EFBIG: "a disk that can hold it",
    errno.ESTALE: "Connect it again",
    errno.ENODEV: "Connect it again",
    errno.EIO: "Copy what is there",
    errno.EMFILE: "ulimit",
}


@pytest.mark.parametrize("number", HELPS, ids=errno.errorcode.get)
def test_the_advice_fits_what_the_disk_refused(number):
    with pytest.raises(CaptureError) as refused, disk_errors("/stage/S"):
        raise OSError(number, os.strerror(number))
    assert str(refused.value).startswith("/stage/S: found ")
    assert HELPS[number] in refused.value.hint


def test_a_refusal_that_nobody_foresaw_is_reported_in_the_systems_words():
    with pytest.raises(CaptureError, match=os.strerror(errno.EDOM)) as refused, disk_errors("S"):
        raise OSError(errno.EDOM, os.strerror(errno.EDOM))
    assert refused.value.hint.endswith("then resume.")


def test_a_session_of_too_long_a_name_asks_for_a_shorter_one_and_makes_nothing(tmp_path, small_rig):
    with pytest.raises(CaptureError, match="File name too long") as refused:
        SessionWriter.new(tmp_path / ("s" * 300), small_rig, SessionPlan(("full",)))
    assert "shorter name" in refused.value.hint
    assert "resume" not in refused.value.hint
    assert not list(tmp_path.iterdir())


def test_a_session_under_a_file_asks_for_another_folder(tmp_path, small_rig):
    (tmp_path / "file").write_text("something else")
    with pytest.raises(CaptureError, match="a file where a folder must be") as refused:
        SessionWriter.new(tmp_path / "file" / "S", small_rig, SessionPlan(("full",)))
    assert refused.value.hint == "Give another folder."
