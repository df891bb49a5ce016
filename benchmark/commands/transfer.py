"""``transfer``: a fitted method of a run on one's own clip."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLES = """\b
Example:
  python -m benchmark transfer --run runs/kg --method dynamic-scaling walk.bvh -o walk-child.bvh
"""


@click.command("transfer", epilog=EXAMPLES)
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.option("--run", "folder", required=True, type=click.Path(path_type=Path), help="The run folder.")
@click.option("--method", "-m", required=True, help="A method of the run, as its tables call it.")
@click.option("--out", "-o", required=True, type=click.Path(path_type=Path), help="The BVH file to write.")
@click.option("--task", "-t", help="Which task, where the run has several.")
@click.option("--repetition", "-r", default=0, show_default=True, help="Which repetition.")
@click.option(
    "--role-map", type=click.Path(path_type=Path), help="TOML that names joints by role: [roles] hips = 'Hip' …"
)
@click.option("--clean", is_flag=True, help="Apply the foot lock that the tables call cleaned.")
@click.option("--seed", default=0, show_default=True, help="Seed, for methods that draw random numbers.")
def transfer(
    source: Path,
    folder: Path,
    method: str,
    out: Path,
    task: str | None,
    repetition: int,
    role_map: Path | None,
    clean: bool,
    seed: int,
) -> None:
    """Apply a trained method of a run to your own clip.

    The clip is brought to the run's conventions first: metres, floor at 0, facing +Z, T-pose prefix removed, the run's
    frame rate.
    """
    from benchmark.motion import bvh, canonical, footlock
    from benchmark.motion.roles import load_role_map
    from benchmark.runner.apply import apply_method

    clip = bvh.load(source, role_map=None if role_map is None else load_role_map(role_map))
    result = apply_method(
        folder,
        method,
        clip,
        lambda loaded, fps: canonical.canonicalise(loaded, fps=fps),
        task=task,
        repetition=repetition,
        seed=seed,
        name=str(source),
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    bvh.save(footlock.lock_feet(result) if clean else result, out)
    click.echo(f"{out}: {len(result)} frames at {result.fps:g} per second, {len(result.skeleton)} joints")
