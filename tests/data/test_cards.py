from __future__ import annotations

import re

import pytest
from pydantic import ValidationError

from benchmark.data.cards import Card, card_ids, list_cards, load_card
from benchmark.data.catalog import open_dataset
from benchmark.errors import ConfigError, UnknownNameError


def test_every_card_is_there_and_says_what_it_must():
    assert card_ids() == ("adult2child", "bandai-namco", "folder", "kinder-gator", "synthetic")
    for card in list_cards():
        assert (
            card.licence.name and card.licence.redistribution and card.citation.text and card.how_to_get and card.traps
        )
        if card.kind == "download":
            assert card.source.url == f"https://github.com/{card.source.repository}/archive/{card.source.commit}.zip"
            assert card.source.commit.startswith(card.version)
            assert all(re.fullmatch(r"[0-9a-f]{64}", digest) for digest in card.digests().values())
            assert all(card.layout.is_data(name) for name in card.digests())
        else:
            assert card.source is None and card.digests() == {}


def test_kinder_gator_names_its_people():
    card = load_card("kinder-gator")
    assert len(card.digests()) == 1159 and len(card.actions) == 58
    ages = {style: [a.age for a in card.actors.values() if a.style == style] for style in ("adult", "child")}
    assert len(ages["adult"]) == len(ages["child"]) == 10
    assert (min(ages["child"]), max(ages["child"])) == (5, 9) and (min(ages["adult"]), max(ages["adult"])) == (19, 32)
    assert card.actors["921"].handedness == "L" and card.actors["644"].sex == "F" and card.actors["644"].age == 9
    named = {re.fullmatch(r"\w+/POSE-p(\d+)_.*", name)[1] for name in card.digests()}
    assert named == set(card.actors)
    done = {re.fullmatch(r".*_\d\d-(.*?)-*-\d+\.csv", name)[1].lower() for name in card.digests()}
    assert done == set(card.actions)


def test_bandai_namco_counts():
    card = load_card("bandai-namco")
    parts = [sum(f"dataset-{n}/data" in name for name in card.digests()) for n in (1, 2)]
    assert parts == [174, 2902] and card.licence.commercial is False
    assert len([s for s, where in card.styles.items() if "dataset-1" in where]) == 15
    assert len([s for s, where in card.styles.items() if "dataset-2" in where]) == 7


def test_the_papers_21_actions():
    assert len(load_card("adult2child").actions) == len(load_card("synthetic").actions) == 21


def test_cards_are_strict():
    card = load_card("synthetic")
    for wrong in ({"licens": "MIT"}, {"fps": "120"}, {"kind": "rented"}):
        with pytest.raises(ValidationError):
            Card.model_validate({**card.model_dump(), **wrong})


def test_unknown_names_suggest():
    with pytest.raises(UnknownNameError, match="did you mean 'kinder-gator'"):
        load_card("kindergator")
    with pytest.raises(UnknownNameError, match="did you mean 'bandai-namco'"):
        open_dataset("bandai_namco")
    with pytest.raises(ConfigError, match="takes no path"):
        open_dataset("bandai-namco:here")


@pytest.mark.real_data
@pytest.mark.parametrize("card_id", ["kinder-gator", "bandai-namco"])
def test_tables_hold_upstreams_digests(real_data, card_id):
    rows = (real_data / f"{card_id}.sha256").read_text().splitlines()
    assert load_card(card_id).digests() == {path: digest for digest, path in (row.split("  ") for row in rows)}


@pytest.mark.real_data
def test_the_readme_says_what_the_card_says_of_actors(kinder_gator):
    text = (kinder_gator / "README.txt").read_text()
    for name, actor in load_card("kinder-gator").actors.items():
        assert re.search(rf"\b{name}\s+{actor.sex}\s+{actor.age}\s+{actor.handedness}\b", text), name
