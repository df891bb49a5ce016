"""The script of an array job is a script, does what it says, and is refused where a job would fail."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmark.commands.slurm import render, slurm_script

#: Runs a submitted script at once, for each task of its array, and notes what it was asked for.
SBATCH = """#!/bin/bash
script=$(mktemp)
cat > "$script"
echo "$@" >> "$LOG"
grep '^#SBATCH' "$script" >> "$LOG"
tasks=$(sed -n 's/^#SBATCH --array=1-//p' "$script")
for task in $(seq 1 "${tasks:-1}"); do
    if [ -n "$tasks" ]; then export SLURM_ARRAY_TASK_ID=$task; else unset SLURM_ARRAY_TASK_ID; fi
    bash "$script" >> "$LOG" 2>&1 || echo "job ended with $?" >> "$LOG"
done
echo "4711;cluster"
"""


def bash(*arguments: str, **options) -> subprocess.CompletedProcess:
    return subprocess.run(["bash", *arguments], capture_output=True, text=True, check=False, **options)


@pytest.mark.parametrize(
    "arguments",
    [("--methods", "all"), ("--methods", "nearest[shortlist=8]", "--out", "a folder/with 'quotes' $HOME `x`")],
)
def test_the_script_is_valid_whatever_is_in_it(tmp_path, arguments):
    text = render(arguments, shards=7, limit="01:00:00", memory="2G", cpus=3, sbatch=("--partition=gpu",))
    path = tmp_path / "job.sh"
    path.write_text(text)
    checked = bash("-n", str(path))
    assert checked.returncode == 0, checked.stderr
    for line in ("--array=1-7", "--cpus-per-task=3", "--time=01:00:00", "--mem-per-cpu=2G", "--partition=gpu"):
        assert f"#SBATCH {line}\n" in text


def test_the_jobs_get_the_arguments_as_they_were_typed(tmp_path):
    """A stand-in for sbatch runs the jobs; one for srun writes down what it is called with."""
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / "sbatch").write_text(SBATCH)
    (tools / "srun").write_text('#!/bin/bash\nprintf "<%s>" "$@" >> "$CALLS"\necho >> "$CALLS"\n')
    for tool in tools.iterdir():
        tool.chmod(0o755)
    script = tmp_path / "job.sh"
    script.write_text(
        render(("--out", "it's $HOME `x`"), shards=2, limit="1", memory="1G", cpus=2, sbatch=("--qos=low",))
    )
    environment = {
        **os.environ,
        "PATH": f"{tools}:{os.environ['PATH']}",
        "LOG": str(tmp_path / "log"),
        "CALLS": str(tmp_path / "calls"),
    }
    done = bash(str(script), env=environment)
    assert done.returncode == 0, done.stderr
    calls = (tmp_path / "calls").read_text().splitlines()
    assert [call.partition("<run>")[2] for call in calls] == [
        "<--out><it's $HOME `x`><--quiet><--jobs><2><--shard><1/2>",
        "<--out><it's $HOME `x`><--quiet><--jobs><2><--shard><2/2>",
        "<--out><it's $HOME `x`><--jobs><1>",
    ]
    log = (tmp_path / "log").read_text()
    assert "--dependency=afterany:4711\n" in log
    assert log.count("#SBATCH --qos=low") == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--shards", "2", "--", "--metods", "all"], "No such option"),
        (["--shards", "2", "--", "--shard", "1/2"], "leave --shard out"),
        (["--shards", "2", "--", "--jobs", "2"], "leave --jobs out"),
        (["--shards", "2", "--sbatch", "--qos=a\nrm -r x"], "a line break"),
        (["--shards", "0"], "not in the range"),
    ],
)
def test_mistakes_are_found_before_anything_is_submitted(arguments, message):
    result = CliRunner().invoke(slurm_script, arguments)
    assert result.exit_code == 2
    assert message in result.output


def test_the_script_can_be_written_to_a_file(tmp_path):
    path = tmp_path / "deep" / "job.sh"
    result = CliRunner().invoke(slurm_script, ["--shards", "3", "-o", str(path), "--", "--methods", "all"])
    assert result.exit_code == 0, result.output
    assert result.output.strip() == f"submit with: bash {path}"
    assert Path(path).read_text().startswith("#!/bin/bash")
