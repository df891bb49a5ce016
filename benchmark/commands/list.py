"""``list``: what there is, where it came from and what it needs. Imports no method and no metric."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import click

from benchmark.registry import FIGURES, METHODS, METRICS, PROBES, Registry


@click.command("list")
@click.argument("what", type=click.Choice(["methods", "metrics", "probes", "datasets", "figures"]))
@click.option(
    "-v", "--verbose", is_flag=True, help="Import the entries too: where they come from, parameters and variants."
)
def list_(what: str, verbose: bool) -> None:
    """List methods, metrics, probes (trained evaluators that metrics look through), datasets or figures."""
    if what == "datasets":
        _list_datasets(verbose)
        return
    registry, facts, details = {
        "methods": (METHODS, _method_facts, _method_details),
        "metrics": (METRICS, _metric_facts, _metric_details),
        "probes": (PROBES, _no_facts, _metric_details),
        "figures": (FIGURES, _no_facts, _no_details),
    }[what]
    _list_entries(registry, facts, details, verbose)


def _list_entries(
    registry: Registry, facts: Callable[[Mapping[str, Any]], str], details: Callable[[Any], list[str]], verbose: bool
) -> None:
    names = registry.names()
    if not names:
        click.echo(f"there are no {registry.kind}s yet")
        return
    width = max(map(len, names))
    for name in names:
        entry, found = registry.entry(name), registry.describe(name)
        line = f"{name:<{width}}  "
        if found.error is not None:
            click.echo(f"{line}cannot be used: {found.error}  [{entry.origin}]")
            continue
        traits = facts(found.facts)
        where = "" if entry.door == "built-in" else f"  [{entry.origin}]"
        click.echo(f"{line}{found.summary}{f'  ({traits})' if traits else ''}{where}")
        if verbose:
            click.echo(f"{'':<{width}}  from: {entry.origin}")
            try:
                lines = details(registry.get(name))
            except Exception as error:  # one broken entry leaves the listing whole
                lines = [f"cannot be used: {error}"]
            for text in lines:
                click.echo(f"{'':<{width}}  {text}")


def _method_facts(facts: Mapping[str, Any]) -> str:
    has = facts.get("capabilities", {})
    traits = [
        {"none": "", "paired": "needs pairs"}.get(has.get("supervision", "unpaired"), "learns from unpaired clips")
    ]
    traits.append("changes timing" if has.get("changes_timing") else "")
    traits.append({"gpu_required": "needs a GPU", "gpu_preferred": "faster on a GPU"}.get(has.get("device", ""), ""))
    traits.append("ceiling row: sees the real clip" if has.get("uses_reference") else "")
    return ", ".join(filter(None, traits))


def _method_details(cls: Any) -> list[str]:
    params = ", ".join(f"{name}={value!r}" for name, value in cls.param_defaults().items())
    variants = ", ".join(name for name in cls.variants() if name)
    lines = [f"parameters: {params or 'none'}"]
    lines += [f"variants: {variants}"] if variants else []
    lines += [f"presets: {', '.join(sorted(cls.presets()))}"] if cls.presets() else []
    lines += [f"source: {cls.info.citation}"] if cls.info.citation else []
    return lines


def _metric_facts(facts: Mapping[str, Any]) -> str:
    direction = {"lower": "lower is better", "higher": "higher is better", "target": f"best at {facts.get('target')}"}
    needs = {"reference": "needs a real target clip", "truth": "needs the true performance"}
    traits = [
        str(facts.get("unit", "")),
        direction.get(facts.get("direction", ""), ""),
        needs.get(facts.get("needs", ""), ""),
        f"through the probe {facts['probe']}" if facts.get("probe") else "",
    ]
    return ", ".join(filter(None, traits))


def _metric_details(metric: Any) -> list[str]:
    return [f"source: {metric.info.citation}"] if metric.info.citation else []


def _no_facts(facts: Mapping[str, Any]) -> str:
    return ""


def _no_details(value: Any) -> list[str]:
    return []


def _list_datasets(verbose: bool) -> None:
    from benchmark.data.catalog import list_cards

    cards = list_cards()
    width = max(len("folder:PATH"), *(len(card.id) for card in cards))
    for card in cards:
        if card.id == "folder":
            continue
        click.echo(f"{card.id:<{width}}  {card.summary}  ({card.licence.name})")
        if verbose:
            styles = ", ".join(card.styles)
            click.echo(
                f"{'':<{width}}  version {card.version}; styles: {styles or 'as found'}; cite: {card.citation.text}"
            )
    click.echo(f"{'folder:PATH':<{width}}  your own files, by a pattern or an index")
