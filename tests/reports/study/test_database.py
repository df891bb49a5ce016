from __future__ import annotations

import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from eval.ratings.reading import PEOPLE
from reports.study.database import Answer, AnswerStore, Full, Refused, new_token
from reports.study.plan import read_plan
from reports.study.schema import connect


@pytest.fixture
def store(study):
    made = AnswerStore(study.database(rehearsal=False), read_plan(study), kind=PEOPLE)
    yield made
    made.close()


def start(store):
    token = new_token()
    store.consent(token, "text", limit=None).result()
    rater = store.rater(token)
    store.start(rater.id).result()
    return store.rater(token)


def answer(store, rater, position, naturalness=4):
    order = store.plan.orders[rater.slot].stimuli
    return store.answer(rater.id, Answer(order[position], "adult", naturalness, None), min_watch=0.0)


def count(store):
    with_others = connect(store.path, read_only=True)
    try:
        return with_others.execute("SELECT count(*) FROM answers").fetchone()[0]
    finally:
        with_others.close()


def test_many_threads_that_send_the_same_answer_store_one(store):
    rater = start(store)
    store.show(rater.id, 0).result()
    with ThreadPoolExecutor(16) as pool:
        list(pool.map(lambda n: answer(store, rater, 0, 1 + n % 7).result(), range(64)))
    assert count(store) == 1


def test_a_change_that_fails_undoes_itself_alone(store):
    rater = start(store)
    store.show(rater.id, 0).result()

    def bad(connection):
        connection.execute("DELETE FROM views")
        connection.execute("INSERT INTO answers VALUES (1, 5, 'x', 'adult', 9, NULL, 0.0, 0.0)")

    futures = [answer(store, rater, 0), store.submit(bad), store.show(rater.id, 1), answer(store, rater, 2)]
    assert futures[0].result() is False
    with pytest.raises(Exception, match="CHECK constraint"):
        futures[1].result()
    assert futures[2].result() >= 0
    with pytest.raises(Refused, match="out of order"):
        futures[3].result()
    assert count(store) == 1 and answer(store, rater, 1).result() is False


def test_the_tables_refuse_what_the_site_would_not_send(store):
    rater = start(store)
    for row in (
        (rater.id, 0, "s", "adult", 8, None, 1.0, 1.0),
        (rater.id, -1, "s", "adult", 4, None, 1.0, 1.0),
        (999, 0, "s", "adult", 4, None, 1.0, 1.0),
        (rater.id, "one", "s", "adult", 4, None, 1.0, 1.0),
        (rater.id, 0, None, "adult", 4, None, 1.0, 1.0),
    ):
        with pytest.raises(Exception, match=r"constraint failed|cannot store"):
            store.submit(lambda c, row=row: c.execute("INSERT INTO answers VALUES (?,?,?,?,?,?,?,?)", row)).result()


def test_orders_are_taken_in_turn_whoever_comes_at_once(store):
    tokens = [new_token() for _ in range(12)]
    for future in [store.consent(token, "text", limit=None) for token in tokens]:
        future.result()
    assert sorted(store.rater(token).slot for token in tokens) == sorted([*range(6), *range(6)])


def test_no_more_raters_than_wanted_whoever_comes_at_once(store):
    futures = [store.consent(new_token(), "text", limit=5) for _ in range(20)]
    assert sum(isinstance(future.exception(), Full) for future in futures) == 15
    assert store.counts() == (0, 5)


def test_an_answer_that_was_confirmed_survives_a_kill(study):
    code = f"""
import os, signal
from pathlib import Path
from eval.ratings.reading import PEOPLE
from reports.study.database import Answer, AnswerStore
from reports.study.layout import StudyFolder
from reports.study.plan import read_plan
folder = StudyFolder(Path({str(study.path)!r}))
store = AnswerStore(folder.database(rehearsal=False), read_plan(folder), kind=PEOPLE)
store.consent("t", "text", limit=None).result()
rater = store.rater("t")
store.start(rater.id).result()
for position, name in enumerate(store.plan.orders[rater.slot].stimuli[:5]):
    store.show(rater.id, position).result()
    store.answer(rater.id, Answer(name, "child", 3, None), min_watch=0.0).result()
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, "OMP_NUM_THREADS": "1"}, check=False)
    assert done.returncode == -signal.SIGKILL
    store = AnswerStore(study.database(rehearsal=False), read_plan(study), kind=PEOPLE)
    try:
        assert count(store) == 5 and store.rater("t").done == 5
    finally:
        store.close()
