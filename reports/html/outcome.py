"""How a run ended: every cell, and every metric without a value, with the reasons."""

from __future__ import annotations

from typing import Any

from reports.run import RunView
from reports.tables import number


def cells(run: RunView) -> list[dict[str, Any]]:
    """Every cell with its status and costs, failed ones first, then skipped ones."""
    rows = []
    names: Any
    for names, group in run.results.groupby(["cell_key", "method", "task", "repetition"], sort=False):
        key, method, task, repetition = names
        costs = group[group["metric"].str.startswith("cost/")]
        good = costs[costs["status"] == "ok"].groupby("metric")["value"].mean()
        whole = costs[costs["metric"] == "cost/fit_seconds"].iloc[0]
        clips = costs[costs["metric"] == "cost/transfer_seconds"]
        clips = clips[clips["clip_id"] != ""]
        lost = clips[clips["status"] != "ok"]
        traceback = f"../cells/{key}/traceback.txt"
        status = "ok" if key not in run.empty_cells else whole["status"]
        rows.append(
            {
                "method": method,
                "task": task.replace(":", " to "),
                "repetition": repetition,
                "status": status,
                "reason": whole["reason"] if status != "ok" else "",
                "traceback": traceback if (run.folder / "report" / traceback).is_file() else "",
                "clips": f"{len(clips) - len(lost)} of {len(clips)}" if len(clips) else "–",
                "lost": [
                    {"reason": reason, "count": int(count)} for reason, count in lost["reason"].value_counts().items()
                ],
                "fit": number(good.get("cost/fit_seconds")),
                "transfer": number(good.get("cost/transfer_seconds")),
                "memory": number(good.get("cost/peak_memory", float("nan")) / 2**20),
                "parameters": _whole(good.get("cost/parameters")),
            }
        )
    order = {"failed": 0, "skipped": 1}
    return sorted(rows, key=lambda row: order.get(row["status"], 2))


def _whole(value: float | None) -> str:
    return "–" if value is None else f"{value:,.0f}"


def holes(run: RunView) -> list[dict[str, Any]]:
    """Metrics without a value for some clips of cells that ended well, by reason: failures first, then by how many."""
    rows = run.results
    # Cells without any result are listed on their own, each with its reason.
    rows = rows[~rows["metric"].str.startswith("cost/") & ~rows["cell_key"].isin(run.empty_cells)]
    totals = rows.groupby("metric").size()
    empty = rows[rows["status"] != "ok"]
    found = empty.groupby(["metric", "status", "reason"], sort=True).agg(
        count=("metric", "size"), methods=("method", lambda names: ", ".join(dict.fromkeys(names)))
    )
    table = found.reset_index().sort_values("count", ascending=False, kind="stable").to_dict("records")
    listed = [{**{str(key): value for key, value in row.items()}, "total": int(totals[row["metric"]])} for row in table]
    return sorted(listed, key=lambda row: row["status"] != "failed")


def alarms(all_cells: list[dict[str, Any]], all_holes: list[dict[str, Any]]) -> list[dict[str, str]]:
    """What has to be said at the top: cells and metrics that failed (a skip is no fault), a line each."""
    lines = [
        {"what": f"{cell['method']}, {cell['task']}, repetition {cell['repetition']} failed", "why": cell["reason"]}
        for cell in all_cells
        if cell["status"] == "failed"
    ]
    for cell in all_cells:
        lost = sum(part["count"] for part in cell["lost"])
        if cell["status"] == "ok" and lost:
            why = "; ".join(part["reason"] for part in cell["lost"])
            what = f"{cell['method']}, {cell['task']}, repetition {cell['repetition']}: no result for {lost} clips"
            lines.append({"what": what, "why": why})
    lines += [
        {
            "what": f"{hole['metric']} failed on {hole['count']} of {hole['total']} rows ({hole['methods']})",
            "why": hole["reason"],
        }
        for hole in all_holes
        if hole["status"] == "failed"
    ]
    return lines
