"""A session through the ASGI application: what a rater sees, and what counts."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing

import pytest

from benchmark.errors import StoreError
from eval.ratings.reading import read_ratings, read_stimuli
from reports.study.export import export_ratings
from reports.study.plan import read_plan, write_plan
from reports.study.simulate import read_page

FORM = {"Content-Type": "application/x-www-form-urlencoded"}


def form_of(page, action):
    (form,) = [form for form in read_page(page.text)[0] if form.action == action]
    return form


def begin(client, *, start=True):
    form = form_of(client.get("/"), "/consent")
    done = client.post("/consent", data={**form.hidden, "adult": "yes", "agree": "yes"})
    assert (done.status_code, done.headers["location"]) == (303, "/instructions")
    if start:
        assert client.post("/start", headers=FORM).headers["location"] == "/page"
    return client.cookies["rater"]


def filled(page, **changes):
    form = form_of(page, "/page")
    return {
        **form.hidden,
        "style": form.choices["style"][0],
        "naturalness": "5",
        "action": form.choices["action"][0],
        **changes,
    }


def rows(study, table="answers", *, rehearsal=False):
    with closing(sqlite3.connect(study.database(rehearsal=rehearsal))) as connection:
        return connection.execute(f"SELECT * FROM {table}").fetchall()


def test_a_session_from_consent_to_thanks(site, study):
    client, made = site()
    page = client.get("/")
    assert page.status_code == 200 and "Filled in &lt;b&gt;&amp;&lt;/b&gt; agreed." in page.text
    assert "set-cookie" not in page.headers
    token = begin(client, start=False)
    assert len(token) == 43
    page = client.get("/instructions")
    assert made.plan.example in page.text and f"http://study.test/r/{token}" in page.text
    assert client.get("/page").headers["location"] == "/instructions"
    assert client.get("/").headers["location"] == "/instructions"
    assert client.post("/start", headers=FORM).headers["location"] == "/page"
    order, given = made.plan.orders[0], []
    for position in range(made.plan.pages):
        assert client.get("/").headers["location"] == "/page"
        page = client.get("/page")
        assert f"<h1>Video {position + 1} of 7</h1>" in page.text
        form = form_of(page, "/page")
        assert form.hidden == {"stimulus": order.stimuli[position]}
        assert form.choices["style"] == list(made.plan.styles if order.first_style == 0 else made.plan.styles[::-1])
        assert form.choices["naturalness"] == list("1234567")
        answer = filled(page, naturalness=str(1 + position))
        given.append((answer["stimulus"], answer["style"], 1 + position, answer["action"]))
        done = client.post("/page", data=answer)
        assert done.status_code == 303
    assert done.headers["location"] == "/thanks"
    assert "Thank you" in client.get("/thanks").text
    for path in ("/", "/page"):
        assert client.get(path).headers["location"] == "/thanks"
    stored = rows(study)
    assert [row[1:6] for row in stored] == [(position, *answer) for position, answer in enumerate(given)]
    export_ratings(study, study.path / "ratings.csv")
    table = read_ratings(study.path / "ratings.csv", read_stimuli(study.key)).table
    assert table["order"].tolist() == list(range(1, 8)) and table["naturalness"].tolist() == list(range(1, 8))
    assert "time" not in table


def test_going_on_where_one_was(site, study):
    client, _ = site()
    token = begin(client)
    for _ in range(3):
        client.post("/page", data=filled(client.get("/page")))
    # The server is started anew, and the browser has its cookie still.
    client.__exit__(None, None, None)
    again, _ = site()
    again.cookies.set("rater", token)
    assert "Video 4 of 7" in again.get("/page").text
    # Another browser, by the personal link.
    third, _ = site()
    link = third.get(f"/r/{token}")
    assert (link.status_code, link.headers["location"]) == (303, "/")
    assert "Video 4 of 7" in third.get("/page").text
    assert third.get("/r/" + "x" * 43).status_code == 404


def test_double_posts_count_once_and_the_first_answer_stays(site, study):
    client, _ = site()
    begin(client)
    answer = filled(client.get("/page"))
    for change in ({}, {}, {"naturalness": "1"}):
        done = client.post("/page", data={**answer, **change})
        assert (done.status_code, done.headers["location"]) == (303, "/page")
    assert [row[4] for row in rows(study)] == [5]
    # So does consent that is sent twice.
    form = form_of(site()[0].get("/"), "/consent")
    for _ in range(2):
        client.cookies.clear()
        client.post("/consent", data={**form.hidden, "adult": "yes", "agree": "yes"})
    assert len(rows(study, "raters")) == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"style": ""}, "Please answer the first question."),
        ({"style": "elder"}, "one of the answers to the first question"),
        ({"naturalness": ""}, "Please answer the second question."),
        ({"naturalness": "0"}, "a number from 1 to 7"),
        ({"naturalness": "8"}, "a number from 1 to 7"),
        ({"naturalness": "5.0"}, "a number from 1 to 7"),
        ({"naturalness": "５"}, "a number from 1 to 7"),  # a full-width digit
        ({"naturalness": "NaN"}, "a number from 1 to 7"),
        ({"action": ""}, "Please answer the third question."),
        ({"action": "<script>alert(1)</script>"}, "one of the answers to the third question"),
        ({"action": "'; DROP TABLE answers; --"}, "one of the answers to the third question"),
    ],
)
def test_answers_out_of_range_are_refused_and_the_rest_of_the_form_is_kept(site, study, change, message):
    client, _ = site()
    begin(client)
    sent = {**filled(client.get("/page")), **change}
    page = client.post("/page", data=sent)
    assert page.status_code == 422 and message in page.text and 'role="alert"' in page.text
    assert "<script>alert" not in page.text
    kept = [name for name in ("style", "naturalness", "action") if name not in change]
    for name in kept:
        assert re.search(rf'name="{name}" value="{sent[name]}"[^>]* checked', page.text), name
    assert rows(study) == []
    assert client.post("/page", data=filled(page)).status_code == 303


def test_answers_out_of_order_are_refused(site, study):
    client, made = site()
    begin(client)
    client.get("/page")
    order = made.plan.orders[0].stimuli
    page = filled(client.get("/page"))
    later = {**page, "stimulus": order[3], "action": made.plan.stimuli[order[3]].actions[0]}
    done = client.post("/page", data=later)
    assert done.status_code == 409 and "not due" in done.text
    for name in ("0" * 16, made.plan.example, "../private/key.csv", ""):
        done = client.post("/page", data={**page, "stimulus": name})
        assert done.status_code == 422 and "belongs to no video" in done.text
    assert rows(study) == []


def test_a_page_that_was_never_shown_cannot_be_answered(site, study):
    client, made = site()
    begin(client)
    name = made.plan.orders[0].stimuli[0]
    blind = {"stimulus": name, "style": "adult", "naturalness": "4", "action": made.plan.stimuli[name].actions[0]}
    assert client.post("/page", data=blind).status_code == 409
    assert rows(study) == []


def test_a_video_must_have_been_shown_for_as_long_as_the_plan_says(site, study):
    now = [1000.0]
    client, made = site(clock=lambda: now[0])
    made.min_watch = 10.0
    begin(client)
    page = client.get("/page")
    assert 'data-wait="10.0"' in page.text
    now[0] += 4
    page = client.post("/page", data=filled(page, naturalness="3"))
    assert page.status_code == 409 and "6 more seconds" in page.text
    assert 'value="3" required checked' in page.text
    # Loading it again does not begin the wait anew, but the time on the page does.
    page = client.get("/page")
    assert 'data-wait="6.0"' in page.text
    now[0] += 7
    assert client.post("/page", data=filled(page)).status_code == 303
    assert [row[6] for row in rows(study)] == [7.0]


def test_withdrawing_deletes_every_answer(site, study):
    client, _ = site()
    token = begin(client)
    client.post("/page", data=filled(client.get("/page")))
    assert "1 of 7 videos" in client.get("/withdraw").text
    done = client.post("/withdraw", headers=FORM)
    assert "Your answers are deleted" in done.text and client.cookies.get("rater") is None
    assert rows(study) == [] and rows(study, "views") == []
    assert client.get(f"/r/{token}").status_code == 410
    client.cookies.set("rater", token)
    assert client.get("/page").headers["location"] == "/withdraw"
    assert client.post("/start", headers=FORM).headers["location"] == "/"
    assert "nothing to delete" in client.get("/withdraw").text


def test_enrolment_closes_when_enough_take_part_and_opens_for_who_left(site, study):
    now = [0.0]
    client, made = site(clock=lambda: now[0])
    for _ in range(made.plan.raters):
        client.cookies.clear()
        begin(client)
    client.cookies.clear()
    page = client.get("/")
    assert page.status_code == 403 and "has enough raters" in page.text
    # Two hours later none of them has gone on: their orders are given to others.
    now[0] += 3 * 3600
    for _ in range(2):
        client.cookies.clear()
        begin(client)
    slots = [row[3] for row in rows(study, "raters")]
    assert slots == [0, 1, 2, 3, 4, 5, 0, 1]


def test_a_script_cannot_fill_the_study_in_a_moment(site, monkeypatch):
    import reports.study.app as app

    monkeypatch.setattr(app, "NEW_A_MINUTE", 2)
    now = [0.0]
    client, _ = site(clock=lambda: now[0])
    form = form_of(client.get("/"), "/consent")
    for _ in range(2):
        client.cookies.clear()
        begin(client)
    client.cookies.clear()
    sent = {**form.hidden, "adult": "yes", "agree": "yes"}
    assert client.post("/consent", data=sent).status_code == 429
    now[0] += 61
    assert client.post("/consent", data=sent).status_code == 303


def test_consent_is_asked_for_and_kept_with_its_text(site, study):
    client, _ = site()
    form = form_of(client.get("/"), "/consent")
    for missing in ({"adult": "yes"}, {"agree": "yes"}, {}):
        page = client.post("/consent", data={**form.hidden, **missing})
        assert page.status_code == 422 and "confirm both statements" in page.text
    assert rows(study, "raters") == []
    begin(client)
    ((digest, text),) = rows(study, "texts")
    (rater,) = rows(study, "raters")
    assert rater[5] == digest and text == (study.texts / "consent.md").read_text()


def test_invited_people_only(site, study):
    from reports.study.serve import invite

    client, _ = site(invited_only=True)
    assert client.get("/").status_code == 403
    (token, other) = invite(study, 2)
    assert client.get(f"/r/{token}").headers["location"] == "/"
    begin(client)
    assert client.cookies["rater"] == token
    assert len(rows(study, "raters")) == 2
    # Without a link there is no way in, not even with a form of the open study.
    assert other not in str(rows(study, "raters"))
    client.cookies.clear()
    assert client.post("/consent", data={"ticket": "a.b", "adult": "yes", "agree": "yes"}).status_code == 403


def test_rehearsals_are_kept_apart(site, study):
    client, _ = site(rehearsal=True)
    assert "Rehearsal." in client.get("/").text and client.get("/health").text == "rehearsal\n"
    begin(client)
    client.post("/page", data=filled(client.get("/page")))
    people, _ = site()
    assert "Rehearsal." not in people.get("/").text
    assert rows(study) == [] and len(rows(study, rehearsal=True)) == 1
    # And one database cannot be passed off as the other.
    for opened in (client, people):
        opened.__exit__(None, None, None)
    study.database(rehearsal=False).unlink()
    study.database(rehearsal=True).rename(study.database(rehearsal=False))
    with pytest.raises(StoreError, match="simulated observers, not people', not of 'people': they are never mixed"):
        site()


def test_answers_to_another_plan_are_refused(site, study):
    _, _made = site()
    with closing(sqlite3.connect(study.database(rehearsal=False), isolation_level=None)) as connection:
        connection.execute("UPDATE study SET plan = 'other'")
    with pytest.raises(StoreError, match="holds answers to another plan"):
        site()
    with closing(sqlite3.connect(study.database(rehearsal=False), isolation_level=None)) as connection:
        connection.execute("PRAGMA user_version = 7")
    with pytest.raises(StoreError, match="version 7"):
        site()


def test_free_text(site, study):
    plan = read_plan(study)
    write_plan(study, plan.model_copy(update={"action_question": "text"}), study.secret.read_bytes())
    client, _ = site()
    begin(client)
    page = client.get("/page")
    assert 'type="text" name="action"' in page.text
    form = form_of(page, "/page")
    base = {**form.hidden, "style": "adult", "naturalness": "4"}
    for text in ("=cmd|' /C calc'!A0", "@SUM(1)", "a\nb", "a\0b", "x" * 201, " "):
        assert client.post("/page", data={**base, "action": text}).status_code == 422, text
    hostile = '\'); DROP TABLE answers; -- <script>alert(1)</script>, "quoted"'
    page = client.post("/page", data={**base, "naturalness": "", "action": hostile})
    assert page.status_code == 422 and "<script>alert" not in page.text and "&lt;script&gt;alert" in page.text
    assert client.post("/page", data={**base, "action": hostile}).status_code == 303
    assert [row[5] for row in rows(study)] == [hostile]
    export_ratings(study, study.path / "ratings.csv")
    assert read_ratings(study.path / "ratings.csv", read_stimuli(study.key)).table["action"].tolist() == [hostile]
