"""What `occlusion` does: bake a table of cast shadows, and train a network where one is named."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from learning.limits import require_within
from learning.occlusion_run import (
    Head,
    bake_heads,
    fingerprint,
    read_head,
    save_occlusion,
    table_of,
    train_occlusion,
)
from learning.render.occlusion_model import OcclusionConfig
from learning.render.occlusion_training import OcclusionTrainConfig
from learning.run import require_new
from lightstage.commands import ProgressCallback
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config, read_toml
from lightstage.formats.template import default_template_path, load_template


def occlusion_command(
    template: Path | None,
    heads: Sequence[Path],
    out: Path,
    rows: int,
    count: int,
    network: Path | None,
    config: Path | None,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Bake a table of cast shadows, and train a network if a folder is named for it; the facts."""
    began = time.monotonic()
    if not 8 <= rows <= 4096 or not 4 <= count <= 65536:
        raise ConfigError(
            "--rows, --directions",
            found=f"{rows}, {count}",
            expected="8 to 4096 rows, 4 to 65536 directions",
        )
    if template is not None and heads:
        raise ConfigError("--template, --head", found="both", expected="one of them")
    training = _occlusion_training(network, config, rows)
    if heads:
        chosen = [read_head(path) for path in heads]
    else:
        mesh = load_template(template or default_template_path()).mesh
        chosen = [Head(mesh, fingerprint(mesh))]
    baked = bake_heads(chosen, OcclusionConfig(rows, count), heads, progress)
    table = table_of(baked)
    facts: dict[str, Any] = {}
    if network is None or training is None:
        table.save(out)
    else:
        trained, score = train_occlusion(chosen, baked, table, training, progress)
        table.save(out)
        save_occlusion(network, trained, training, chosen, not heads, score)
        facts = {
            "network": str(network),
            "steps": training.steps,
            "joint_steps": training.joint_steps,
            **{f"score_{name}": figure for name, figure in score.figures().items()},
            "said": score.sentence(),
        }
    return {
        "directions": count,
        "heads": len(chosen),
        "rows": rows,
        "columns": table.covered.shape[1],
        "bytes": out.stat().st_size,
        **facts,
        "seconds": time.monotonic() - began,
    }


def _occlusion_training(
    network: Path | None, config: Path | None, rows: int
) -> OcclusionTrainConfig | None:
    """The configuration of a network's training; None where none is asked for."""
    if network is None:
        if config is not None:
            raise ConfigError(
                "--config",
                found=f"{config} without --network",
                expected="both or neither",
                hint="It is the training's; a table has --rows and --directions.",
            )
        return None
    require_new(network, "Choose another --network, or remove that run first.")
    values = read_toml(config) if config else {}
    where = config or "--rows"
    sizes = values.get("occlusion", {})
    if isinstance(sizes, dict):
        if "rows" in sizes:
            raise ConfigError(
                where,
                field="occlusion.rows",
                found=str(sizes["rows"]),
                expected="none",
                hint="Give --rows: table and network are of the same pictures.",
            )
        values = {**values, "occlusion": {**sizes, "rows": rows}}
    training = make_config(OcclusionTrainConfig, values, where)
    require_within(training, where)
    return training
