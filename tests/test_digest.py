from __future__ import annotations

import hashlib
import json
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.digest import VaryingDigest, canonical_json, code_digest, digest, import_closure, source_digest
from benchmark.errors import ConfigError, RegistryError

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def test_known_text_and_digest():
    value = {"b": [1, 2.5, True, None], "a": {"z": "ü", "y": -0.0}}
    text = '{"a":{"y":0.0,"z":"ü"},"b":[1,2.5,true,null]}'
    assert canonical_json(value) == text
    assert digest(value) == hashlib.sha256(text.encode()).hexdigest()


@settings(max_examples=60, deadline=None)
@given(JSON)
def test_text_reads_back_as_the_value(value):
    assert json.loads(canonical_json(value)) == value


def test_order_of_keys_and_kind_of_sequence_do_not_matter():
    assert digest({"a": 1, "b": (1, 2)}) == digest({"b": [1, 2], "a": 1})


def test_integers_floats_and_booleans_stay_apart():
    assert len({digest(1), digest(1.0), digest(True), digest("1")}) == 4


def test_numpy_values_equal_python_values():
    value = {"a": np.float64(0.1), "b": np.arange(3), "c": np.bool_(True)}
    assert digest(value) == digest({"a": 0.1, "b": [0, 1, 2], "c": True})


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), {1: 2}, {"a": object()}, {"a": {"b": [np.nan]}}])
def test_what_has_no_canonical_text_is_refused(bad):
    with pytest.raises(ConfigError, match="value"):
        canonical_json(bad)


def test_the_refusal_says_where():
    with pytest.raises(ConfigError, match=r"value\.a\.b\[1\] is nan"):
        canonical_json({"a": {"b": [0.0, float("nan")]}})


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package ``pkg_under_test`` in which nothing may be imported."""
    root = tmp_path / "pkg_under_test"
    (root / "sub").mkdir(parents=True)
    files = {
        "__init__.py": "raise SystemExit('imported')\n",
        "main.py": "import numpy\nfrom pkg_under_test.helper import f\ndef g():\n    from pkg_under_test.sub import late\n",
        "helper.py": "from . import base\n",
        "base.py": "X = 1\n",
        "other.py": "Y = 1\n",
        "sub/__init__.py": "Z = 1\n",
        "sub/late.py": "W = 1\n",
    }
    for name, text in files.items():
        (root / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    return root


def test_source_digest_imports_nothing_and_sees_every_module_of_a_package(package):
    before = source_digest("pkg_under_test")
    assert not any(name.startswith("pkg_under_test") for name in sys.modules)
    (package / "sub" / "late.py").write_text("W = 2\n")
    assert source_digest("pkg_under_test") != before


def test_source_digest_ignores_line_endings_and_order(package):
    before = source_digest("pkg_under_test.base", "pkg_under_test.other")
    (package / "base.py").write_bytes(b"X = 1\r\n")
    assert source_digest("pkg_under_test.other", "pkg_under_test.base") == before


def test_source_digest_of_an_absent_module_names_it():
    with pytest.raises(RegistryError, match="no_such_module"):
        source_digest("no_such_module.at_all")
    with pytest.raises(RegistryError, match=r"benchmark\.nothing"):
        source_digest("benchmark.nothing")


def test_import_closure_follows_absolute_relative_and_late_imports(package):
    assert import_closure("pkg_under_test.main") == (
        "pkg_under_test.base",
        "pkg_under_test.helper",
        "pkg_under_test.main",
        "pkg_under_test.sub.late",
    )


@pytest.mark.parametrize(
    ("changed", "matters"), [("base.py", True), ("sub/late.py", True), ("other.py", False), ("__init__.py", False)]
)
def test_code_digest_changes_with_what_is_imported_only(package, changed, matters):
    before = code_digest(["pkg_under_test.main"])
    (package / changed).write_text("CHANGED = 1\n")
    assert (code_digest(["pkg_under_test.main"]) != before) == matters


def test_code_digest_sees_declared_modules(package):
    before = code_digest(["pkg_under_test.main"], ["pkg_under_test.other"])
    (package / "other.py").write_text("Y = 2\n")
    assert code_digest(["pkg_under_test.main"], ["pkg_under_test.other"]) != before


def test_a_registered_method_is_left_alone_by_the_list_of_methods():
    assert "methods" not in import_closure("methods.identity")
    assert "methods.identity" in import_closure("methods.identity")


@given(
    st.dictionaries(st.text(max_size=4), st.integers() | st.text(max_size=4) | st.booleans()), st.integers(), st.text()
)
def test_a_varying_digest_is_the_digest_of_the_whole(fixed, number, text):
    whole = {**fixed, "b": number, 'ä"': text}
    assert VaryingDigest(fixed, ("b", 'ä"'))(**{"b": number, 'ä"': text}) == digest(whole)
