"""A run that is killed while it saves: it always has one whole checkpoint."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import torch

from learning.checkpoint import load_tensors, read_checkpoint

ROLES = ("generator", "training")
ABOUT = {
    "config": {},
    "data_fingerprint": "none",
    "held_out": [],
    "texture_rows": 96,
    "metrics": {},
}
KILLED_AT_EVERY_CHANGE = """
import json, os, shutil, signal, sys
from pathlib import Path
import torch
from learning.checkpoint import save_checkpoint

folder, roles, about = Path(sys.argv[1]), json.loads(sys.argv[2]), json.loads(sys.argv[3])

def save(step):
    tensors = {role: {"w": torch.full((8, 8), float(step))} for role in roles}
    save_checkpoint(folder, step, tensors, about)

def dies_before(left):
    # Whatever changes a name or is to reach the disk: the process is killed before the nth.
    def counted(real):
        def call(*args, **kwargs):
            left[0] -= 1
            if left[0] < 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return real(*args, **kwargs)
        return call
    for name in ("replace", "fsync", "unlink"):
        setattr(os, name, counted(getattr(os, name)))

save(1)
for changes in range(1000):
    child = os.fork()
    if not child:
        dies_before([changes])
        save(changes + 2)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    shutil.copytree(folder, folder.parent / f"kept-{changes:04d}")
    if status == 0:
        break
    assert os.WIFSIGNALED(status)
"""


def test_a_save_that_is_killed_anywhere_leaves_one_whole_checkpoint(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    told = [str(run), json.dumps(ROLES), json.dumps(ABOUT)]
    subprocess.run([sys.executable, "-c", KILLED_AT_EVERY_CHANGE, *told], check=True)
    after = sorted(tmp_path.glob("kept-*"))
    assert len(after) > 8  # three files, each written, renamed and made to reach the disk
    before = 1
    for killed, folder in enumerate(after):
        checkpoint = read_checkpoint(folder)
        assert checkpoint.step in (before, killed + 2)
        before = checkpoint.step
        for role in ROLES:
            weights = load_tensors(checkpoint, role)["w"]
            assert torch.equal(weights, torch.full((8, 8), float(checkpoint.step)))
    assert before == len(after) + 1
    # What the killed saves left is removed by the next that comes to its end.
    left = {path.name for path in after[-1].iterdir()}
    files = read_checkpoint(after[-1]).files.values()
    assert left == {"checkpoint.json", *(entry["name"] for entry in files)}
