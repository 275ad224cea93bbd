"""Cameras are checked while the views are made: which fault is told, and that none is lost."""

from pathlib import Path
from unittest import mock

import pytest

from processing.errors import PoseError, ReconstructionError
from processing.reconstruction import stage
from processing.reconstruction.config import ReconstructConfig


def fault(kind):
    return kind("here", found="something", expected="something else")


@pytest.mark.parametrize(
    ("poses", "views", "values"),
    [
        (PoseError, ReconstructionError, PoseError),
        (PoseError, None, PoseError),
        (None, ReconstructionError, ReconstructionError),
    ],
)
def test_cameras_that_stand_elsewhere_are_named_before_any_other_fault(poses, views, values):
    def check(*given):
        del given
        if poses:
            raise fault(poses)

    def read(*given, **how):
        del given, how
        if views:
            raise fault(views)
        return [], None

    with (
        mock.patch.object(stage, "check_session_poses", check),
        mock.patch.object(stage, "read_views", read),
        pytest.raises(values),
    ):
        stage.reconstruct(None, Path("nowhere"), ReconstructConfig())
