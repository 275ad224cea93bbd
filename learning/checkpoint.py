"""Checkpoints: weights as safetensors, everything else as JSON; no code runs when one is loaded.

    RUN/checkpoint.json            the index: configuration, data, code, metrics, names and hashes
    RUN/generator-STEP.safetensors (a whole face's network: network-STEP; four: generators-STEP)
    RUN/average-STEP.safetensors   the same networks with their weights' moving average, where there
                                   is one: it is scored and inferred with
    RUN/training-STEP.safetensors  discriminators and optimisers, to resume from

The JSON is renamed into place last, so a run always has one whole checkpoint.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.metadata
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from learning.errors import CheckpointError
from learning.limits import require_within
from learning.mesostructure.network import Mesostructure, MesostructureConfig
from learning.networks.generator import Generator, GeneratorConfig
from learning.networks.whole_face import WholeFaceConfig, WholeFaceNetwork
from learning.upscale.network import Rcan, RcanConfig
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config
from lightstage.formats.files import atomic_path, leftovers, read_json, sha256_file, write_json
from lightstage.formats.paths import check_name, path_inside

NetworkT = TypeVar("NetworkT", bound=nn.Module)
SizeT = TypeVar("SizeT")
SCHEMA = "lightstage.checkpoint/1"
INDEX = "checkpoint.json"
AVERAGE = "average"
"""Role of the network with averaged weights. Older checkpoints have none."""


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """The content of checkpoint.json.

    Attributes:
        folder: of its files.
        family: of networks: `patches`, `four_networks`, `whole_face`, `super_resolution`,
            `mesostructure`, `occlusion` or `points`.
        step: training steps done.
        config: the resolved configuration.
        data_fingerprint: of the store.
        held_out: people who were not trained on.
        texture_rows: of the maps trained on, which is the size of skin's detail for the network.
        code_version: of this package when it was saved.
        metrics: when it was saved.
        step_seconds: what these steps took, but for the first of each call, which compiles loops.
        files: role (generator, generators or network; average; training) to {name, sha256}.
        began_with: `files` of the run whose networks it began with; empty where these were random.
        trained_on: the traces (`Scan.trace`) of the scans that it, and those that it began with,
            were trained on; of an earlier version their SHA-256. Empty where that was not recorded.
    """

    folder: Path
    family: str
    step: int
    config: dict[str, Any]
    data_fingerprint: str
    held_out: list[str]
    texture_rows: int
    code_version: str
    metrics: dict[str, float]
    step_seconds: float
    files: dict[str, dict[str, str]]
    began_with: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)
    trained_on: tuple[str, ...] = ()


def save_checkpoint(
    folder: Path,
    step: int,
    tensors: dict[str, dict[str, Tensor]],
    about: dict[str, Any],
) -> Path:
    """Write a checkpoint; remove the one before it, and what killed saves left.

    Args:
        folder: the run.
        step: training steps done.
        tensors: role, as in `Checkpoint.files`, to named tensors.
        about: the other fields of `Checkpoint`.

    Returns:
        Path of the index.
    """
    files: dict[str, dict[str, str]] = {}
    index = folder / INDEX
    known = set(folder.glob("*.safetensors"))
    try:
        for role, named in tensors.items():
            path = save_tensors(_free(folder, role, step), named)
            files[role] = {"name": path.name, "sha256": sha256_file(path)}
        value = {"schema": SCHEMA, "step": step, **about, "code_version": code_version()}
        write_json(index, {**value, "files": files})
    except OSError:
        # A full disk is not made fuller by weights that nothing names.
        for path in set(folder.glob("*.safetensors")) - known:
            path.unlink()
        raise
    kept = {entry["name"] for entry in files.values()}
    names = [f"{role}-*.safetensors" for role in tensors]
    old = [path for name in names for path in folder.glob(name) if path.name not in kept]
    for path in (*old, *(path for name in (*names, INDEX) for path in leftovers(folder, name))):
        path.unlink()
    return index


def _free(folder: Path, role: str, step: int) -> Path:
    """A file's name that is not there: what the present index names stays until the next is there.

    A step is saved twice where it is the last one: among the steps, and scored.
    """
    path, count = folder / f"{role}-{step:07d}.safetensors", 1
    while path.exists():
        count += 1
        path = folder / f"{role}-{step:07d}-{count}.safetensors"
    return path


def save_tensors(path: Path, named: dict[str, Tensor]) -> Path:
    """Write tensors by their names, wherever they are; returns `path`."""
    with atomic_path(path) as beside:
        save_file({n: value.detach().cpu().contiguous() for n, value in named.items()}, beside)
        # safetensors makes its files the owner's alone, whatever the user's umask is.
        beside.chmod(0o666 & ~_umask())
    return path


def _umask() -> int:
    """The process's mask of file permissions, which can only be read by setting it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def read_checkpoint(path: Path) -> Checkpoint:
    """Read the index of a run folder, or a checkpoint.json itself.

    Raises:
        FormatError, CheckpointError: missing, of another kind, or fields missing.
    """
    # Suffixes decide nothing of a folder: a run's name may have a full stop in it.
    index = path if path.suffix == ".json" and not path.is_dir() else path / INDEX
    if index != path and path.is_file():
        raise CheckpointError(
            path,
            found=f"a file with the suffix {path.suffix!r}",
            expected=f"a run folder or its {INDEX}",
        )
    value = read_json(index, SCHEMA)
    try:
        return Checkpoint(
            index.parent,
            # Before there were two families, all were of patches.
            str(value.get("family", "patches")),
            int(value["step"]),
            dict(value["config"]),
            str(value["data_fingerprint"]),
            [str(name) for name in value["held_out"]],
            int(value["texture_rows"]),
            str(value["code_version"]),
            {str(name): float(number) for name, number in value["metrics"].items()},
            float(value.get("step_seconds", 0.0)),  # older ones lack it
            {
                role: {
                    "name": check_name(f["name"], index, f"files.{role}.name", CheckpointError),
                    "sha256": str(f["sha256"]),
                }
                for role, f in value["files"].items()
            },
            dict(value.get("began_with", {})),
            tuple(map(str, value.get("trained_on", ()))),
        )
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise CheckpointError(
            index, found=f"no usable {error}", expected="the fields of a checkpoint"
        ) from None


def load_tensors(checkpoint: Checkpoint, role: str) -> dict[str, Tensor]:
    """Read one file of a checkpoint; CheckpointError when it is missing or not what was saved."""
    entry = checkpoint.files.get(role)
    if entry is None:
        raise CheckpointError(checkpoint.folder / INDEX, found=f"no {role}", expected=role)
    index = checkpoint.folder / INDEX
    path = path_inside(checkpoint.folder, entry["name"], index, role, CheckpointError)
    if not path.is_file():
        raise CheckpointError(path, found="no such file", expected=f"the weights of the {role}")
    if sha256_file(path) != entry["sha256"]:
        raise CheckpointError(
            path,
            found="other bytes than were saved",
            expected=f"SHA-256 {entry['sha256'][:12]}..",
            hint="The file was changed or cut; copy the run again.",
        )
    try:
        tensors = load_file(path)
    except (SafetensorError, OSError) as error:
        raise CheckpointError(path, found=str(error), expected="a safetensors file") from None
    for name in not_finite(tensors):
        raise CheckpointError(
            path,
            field=name,
            found=counted(int((~tensors[name].isfinite()).sum()), "NaN or infinite value"),
            expected="finite weights",
            hint="The training diverged; use an earlier checkpoint or a lower learning_rate.",
        )
    return tensors


def not_finite(tensors: dict[str, Tensor]) -> Iterator[str]:
    """Names of the tensors that hold NaN or infinity."""
    for name, values in tensors.items():
        if values.is_floating_point() and not bool(values.isfinite().all()):
            yield name


def load_network(
    path: Path,
    family: str,
    table: str,
    size_of: type[SizeT],
    make: Callable[[SizeT], NetworkT],
    role: str = "",
) -> tuple[NetworkT, Checkpoint]:
    """A family's network of a checkpoint, ready to infer with: averaged where it kept an average.

    Args:
        path: run folder, or its checkpoint.json.
        family: of the network.
        table: of the configuration that has its size.
        size_of: class of that table.
        make: the network of a size.
        role: of its file; as the table where empty.

    Raises:
        CheckpointError, FormatError, ConfigError: as `read_checkpoint`, or weights of another
            network.
    """
    checkpoint, where = of_family(path, family)
    size = make_config(size_of, checkpoint.config.get(table, {}), where)
    require_within(size, where, table)
    network = make(size)
    fill(network, trained_tensors(checkpoint, role or table), where)
    return network.eval(), checkpoint


def load_generator(path: Path) -> tuple[Generator, Checkpoint]:
    """The generator of a checkpoint; otherwise as `load_network`."""

    def make(size: GeneratorConfig) -> Generator:
        return unfilled(lambda: Generator(size))

    return load_network(path, "patches", "generator", GeneratorConfig, make)


def load_whole_face(path: Path) -> tuple[WholeFaceNetwork, Checkpoint]:
    """The whole-face network of a checkpoint; otherwise as `load_network`."""
    return load_network(path, "whole_face", "network", WholeFaceConfig, WholeFaceNetwork)


def whole_face_of(checkpoint: Path | None) -> WholeFaceNetwork:
    """The network of the option --checkpoint; the shipped one where it is absent.

    Raises:
        ConfigError: a network of another family.
        CheckpointError: see `load_network`.
    """
    about = read_checkpoint(checkpoint or shipped_weights())
    if about.family != "whole_face":
        raise ConfigError(
            "--checkpoint",
            found=f"a network of the family {about.family!r}",
            expected="a whole-face network",
            hint="Leave --checkpoint out for the weights that are shipped.",
        )
    return load_whole_face(about.folder)[0]


def load_super_resolution(path: Path) -> tuple[Rcan, Checkpoint]:
    """An RCAN of a checkpoint; otherwise as `load_network`."""
    return load_network(path, "super_resolution", "network", RcanConfig, Rcan)


def load_mesostructure(path: Path) -> tuple[Mesostructure, Checkpoint]:
    """The mesostructure network of a checkpoint; otherwise as `load_network`."""
    return load_network(path, "mesostructure", "network", MesostructureConfig, Mesostructure)


def unfilled(make: Callable[[], NetworkT]) -> NetworkT:
    """A network without the time to draw its weights, all of which are to be filled."""
    with torch.device("meta"):
        network = make()
    return network.to_empty(device="cpu")


def trained_tensors(checkpoint: Checkpoint, role: str) -> dict[str, Tensor]:
    """The weights to infer with: the average where one was kept, the role's own else."""
    return load_tensors(checkpoint, AVERAGE if AVERAGE in checkpoint.files else role)


def shipped_weights() -> Path:
    """The run folder of the whole-face network that this package brings."""
    return Path(__file__).parent / "data" / "whole_face"


def shipped_super_resolution() -> Path:
    """The run folder of the super-resolution that this package brings."""
    return Path(__file__).parent / "data" / "upscale"


def shipped_mesostructure() -> Path:
    """The run folder of the mesostructure network that this package brings."""
    return Path(__file__).parent / "data" / "mesostructure"


def shipped_points() -> Path:
    """The run folder of the network of template points that this package brings."""
    return Path(__file__).parent / "data" / "points"


def of_family(path: Path, family: str) -> tuple[Checkpoint, Path]:
    """A checkpoint and its index; CheckpointError where its networks are of another family."""
    checkpoint = read_checkpoint(path)
    where = checkpoint.folder / INDEX
    if checkpoint.family != family:
        raise CheckpointError(
            where,
            field="family",
            found=checkpoint.family,
            expected=family,
            hint="`infer` takes networks of whole_face, patches and four_networks, `upscale` of "
            "super_resolution, `infer --mesostructure` of mesostructure, `--shadows network:` of "
            "occlusion.",
        )
    return checkpoint, where


def fill(network: nn.Module, tensors: dict[str, Tensor], where: Path) -> None:
    """Put weights into a network; CheckpointError when they are not its own."""
    own_tensors = network.state_dict()
    # Weights of another type would be converted in silence.
    for name, own in own_tensors.items():
        if name in tensors and tensors[name].dtype != own.dtype:
            raise CheckpointError(
                where,
                field=f"weights, {name}",
                found=str(tensors[name].dtype),
                expected=str(own.dtype),
                hint="The file was changed; copy the run again.",
            )
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise CheckpointError(
            where,
            field="weights",
            found=str(error).splitlines()[-1].strip(),
            expected="those of the configured network",
        ) from None


def part_of(tensors: dict[str, Tensor], name: str) -> dict[str, Tensor]:
    """Those whose names begin with NAME and a full stop, without that."""
    prefix = f"{name}."
    return {k[len(prefix) :]: v for k, v in tensors.items() if k.startswith(prefix)}


def adam_tensors(optimiser: torch.optim.Adam, prefix: str) -> dict[str, Tensor]:
    """An optimiser's state as named tensors."""
    state = optimiser.state_dict()["state"]
    return {
        f"{prefix}.{index}.{name}": value
        for index, entry in state.items()
        for name, value in entry.items()
    }


def fill_adam(optimiser: torch.optim.Adam, tensors: dict[str, Tensor], prefix: str) -> None:
    """The inverse of `adam_tensors`."""
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith(prefix + "."):
            _, index, field = name.rsplit(".", 2)
            state.setdefault(int(index), {})[field] = value
    # Moves the state to where the weights are.
    optimiser.load_state_dict({**optimiser.state_dict(), "state": state})


@functools.cache
def code_version() -> str:
    """The project's version and a hash of this package's sources."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return f"{importlib.metadata.version('lightstage')}+{digest.hexdigest()[:12]}"
