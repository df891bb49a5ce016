"""What the site refuses, and what every response carries."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing

import pytest

from reports.study.guard import HEADERS
from reports.study.simulate import read_page

FORM = {"Content-Type": "application/x-www-form-urlencoded"}


def begin(client):
    form = read_page(client.get("/").text)[0][0]
    client.post("/consent", data={**form.hidden, "adult": "yes", "agree": "yes"})
    client.post("/start", headers=FORM)
    return client.cookies["rater"]


def due(page):
    return re.search(r'name="stimulus" value="(\w+)"', page.text)[1]


@pytest.fixture
def rater(site):
    """A client in the middle of a session, and the site."""
    client, made = site()
    begin(client)
    return client, made


def test_headers_of_every_response(rater):
    client, _made = rater
    video = f"/stimuli/{due(client.get('/page'))}.mp4"
    for method, path in (
        *(
            ("GET", path)
            for path in ("/", "/page", "/instructions", "/withdraw", "/static/style.css", "/nothing", video)
        ),
        *(("POST", "/thanks"), ("GET", "/health"), ("PUT", "/page"), ("GET", "/" + "x" * 600)),
    ):
        answer = client.request(method, path)
        for name, value in HEADERS.items():
            assert answer.headers.get(name) == value, (path, name)
        assert "cache-control" in answer.headers
        assert "unsafe" not in answer.headers["content-security-policy"]
    assert client.get("/page").headers["cache-control"] == "no-store"
    assert "strict-transport-security" not in client.get("/").headers


def test_nothing_on_a_page_needs_what_the_policy_forbids(rater):
    client, _ = rater
    for path in ("/page", "/instructions", "/withdraw"):
        text = client.get(path).text
        assert not re.search(r"\son\w+=|style=|<style|javascript:", text)
        assert not re.search(r'(?:src|href|action)="(?!/)', text)
        for script in re.findall(r"<script[^>]*>[^<]*", text):
            assert re.fullmatch(r'<script src="/static/page.js" defer>', script)


def test_the_cookie(site):
    client, _ = site()
    form = read_page(client.get("/").text)[0][0]
    sent = {**form.hidden, "adult": "yes", "agree": "yes"}
    cookie = client.post("/consent", data=sent).headers["set-cookie"].lower()
    assert "httponly" in cookie and "samesite=lax" in cookie and "path=/" in cookie and "secure" not in cookie
    client.cookies.clear()
    form = read_page(client.get("/").text)[0][0]
    sent = {**form.hidden, "adult": "yes", "agree": "yes"}
    secure = client.post("https://study.test/consent", data=sent)
    assert "; secure" in secure.headers["set-cookie"].lower()
    assert "strict-transport-security" in secure.headers


@pytest.mark.parametrize("token", ["x", "x" * 43, "' OR 1=1 --", "../../etc/passwd", "\x7f", "é" * 20, "x" * 400])
def test_forged_tokens_are_strangers(rater, study, token):
    client, made = rater
    name = due(client.get("/page"))
    headers = {"Cookie": b"rater=" + token.encode()}
    client.cookies.clear()
    assert client.get("/page", headers=headers).headers["location"] == "/"
    assert client.get(f"/stimuli/{name}.mp4", headers=headers).status_code == 404
    answer = {"stimulus": name, "style": "adult", "naturalness": "4", "action": made.plan.stimuli[name].actions[0]}
    done = client.post("/page", data=answer, headers=headers)
    assert done.status_code == 403 and "was not stored" in done.text
    with closing(sqlite3.connect(study.database(rehearsal=False), isolation_level=None)) as connection:
        assert connection.execute("SELECT count(*) FROM answers").fetchone() == (0,)


def test_a_token_is_stored_as_its_hash_and_nothing_of_the_rater_s_machine_is(site, study):
    client, made = site()
    client.headers["User-Agent"] = "Peculiar/1.0"
    token = begin(client)
    made.store.submit(lambda connection: None).result()
    data = b"".join(path.read_bytes() for path in study.answers.iterdir())
    for secret in (token.encode(), b"Peculiar", b"testclient", b"127.0.0.1"):
        assert secret not in data


def test_an_answer_goes_to_the_session_of_its_cookie_only(site, study):
    first, made = site()
    begin(first)
    page = first.get("/page")
    second, _ = site()
    begin(second)
    name = due(page)
    answer = {"stimulus": name, "style": "adult", "naturalness": "4", "action": made.plan.stimuli[name].actions[0]}
    # The second rater has another order: the first one's form is not due there, and changes nothing of the first.
    other = due(second.get("/page"))
    done = second.post("/page", data=answer)
    assert done.status_code == (303 if other == name else 409)
    assert due(first.get("/page")) == name


def test_only_the_video_that_is_due_and_the_example_are_handed_out(rater):
    client, made = rater
    order = made.plan.orders[0].stimuli
    client.get("/page")
    for name in made.plan.stimuli:
        status = 200 if name in (order[0], made.plan.example) else 404
        assert client.get(f"/stimuli/{name}.mp4").status_code == status
    client.cookies.clear()
    for name in (order[0], made.plan.example):
        assert client.get(f"/stimuli/{name}.mp4").status_code == 404


@pytest.mark.parametrize(
    "path",
    [
        "/stimuli/../private/key.csv",
        "/stimuli/..%2Fprivate%2Fkey.csv",
        "/stimuli/%2e%2e/private/secret",
        "/stimuli/..%252Fprivate%252Fkey.csv",
        "/stimuli/%2Fetc%2Fpasswd",
        "/stimuli/..\\private\\key.csv",
        "/stimuli/..%5Cprivate%5Ckey.csv",
        "/stimuli/{due}.mp4%00.png",
        "/stimuli/{due}.mp4/../../plan.json",
        "/stimuli/.",
        "/stimuli/",
        "/static/../app.py",
        "/static/..%2F..%2F__init__.py",
        "/static/base.html.j2",
        "/static/consent.md.j2",
        "/plan.json",
        "/private/key.csv",
        "/answers/people.sqlite3",
        "/r/..%2Fprivate%2Fsecret",
        "/docs",
        "/openapi.json",
    ],
)
def test_paths_do_not_escape(rater, study, path):
    client, _ = rater
    target = path.replace("{due}", due(client.get("/page")))
    # The address goes to the application as it is: a client would clean it up first.
    answer = client.request("GET", "http://study.test/", extensions={"target": target.encode()})
    answer = client.get(target)
    assert answer.status_code == 404, target
    secret = study.secret.read_bytes()
    for word in (b"bold", b"condition", b"root:", secret):
        assert word not in answer.content


def test_raw_paths_do_not_escape_a_real_server(serving, study):
    import socket
    from urllib.parse import urlsplit

    with serving(study, "--rehearsal") as (address, _):
        place = urlsplit(address)
        for path in (
            "/stimuli/../private/key.csv",
            "/../../etc/passwd",
            "//etc/passwd",
            "/stimuli/..%2f..%2fplan.json",
        ):
            with socket.create_connection((place.hostname, place.port), timeout=10) as wire:
                wire.sendall(f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n".encode())
                said = b"".join(iter(lambda: wire.recv(65536), b""))
            assert said.split(b"\r\n")[0].endswith(b"404 Not Found"), path
            assert b"condition" not in said and b"root:" not in said
        # Ten megabytes, announced and not: refused before they are read.
        for head in (b"Content-Length: 10485760\r\n", b"Transfer-Encoding: chunked\r\n"):
            with socket.create_connection((place.hostname, place.port), timeout=10) as wire:
                wire.sendall(
                    b"POST /page HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-www-form-urlencoded\r\n" + head
                )
                wire.sendall(b"\r\n")
                sent = 0
                try:
                    for _ in range(160):
                        part = b"a" * 65536
                        wire.sendall(b"10000\r\n" + part + b"\r\n" if b"chunked" in head else part)
                        sent += len(part)
                except OSError:
                    pass
                try:
                    said = wire.recv(200)
                except OSError:  # reset by the server, which had enough
                    said = b""
            assert b" 413 " in said or sent < 10485760, head


def test_a_body_of_ten_megabytes_is_refused_without_reading_it(rater):
    client, _ = rater
    read = []

    def body():
        for _ in range(160):
            read.append(65536)
            yield b"x" * 65536

    announced = client.post("/page", content=b"x" * 10_485_760, headers=FORM)
    assert announced.status_code == 413 and "at most 64 kB" in announced.text
    streamed = client.post("/page", content=body(), headers=FORM)
    assert streamed.status_code == 413 and streamed.headers["connection"] == "close"
    assert client.post("/page", content=b"", headers={**FORM, "Content-Length": "-1"}).status_code == 400


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"%", 422),
        (b"stimulus", 400),
        (b"stimulus=%ff", 400),
        (b"\xff=1", 400),
        (b"a=1&a=2", 400),
        (b"&".join(b"f%d=1" % n for n in range(50)), 400),
        (b"", 422),
        (b"stimulus[$ne]=1", 422),
    ],
)
def test_bodies_that_are_no_form(rater, body, status):
    client, _ = rater
    done = client.post("/page", content=body, headers=FORM)
    assert done.status_code in (status, 400, 422) and done.status_code < 500
    assert "Traceback" not in done.text


def test_other_types_methods_and_sites(rater):
    client, _ = rater
    for kind in ("application/json", "multipart/form-data; boundary=x", "text/plain"):
        assert client.post("/page", content=b"{}", headers={"Content-Type": kind}).status_code == 415
    for method, path in (
        *(("DELETE", "/page"), ("PUT", "/page"), ("PATCH", "/"), ("POST", "/"), ("GET", "/consent"), ("GET", "/start")),
        *(("POST", "/thanks"), ("OPTIONS", "/page"), ("TRACE", "/")),
    ):
        answer = client.request(method, path, headers=FORM if method == "POST" else None)
        assert answer.status_code == 405, (method, path)
    for headers in (
        {"Origin": "https://elsewhere.test"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ):
        assert client.post("/withdraw", headers={**FORM, **headers}).status_code == 403
    for headers in ({"Origin": "http://study.test"}, {"Origin": "null", "Sec-Fetch-Site": "same-origin"}):
        assert client.post("/start", headers={**FORM, **headers}).status_code == 303


def test_videos_by_range(rater):
    client, _ = rater
    path = f"/stimuli/{due(client.get('/page'))}.mp4"
    whole = client.get(path)
    assert whole.headers["accept-ranges"] == "bytes" and whole.headers["content-type"] == "video/mp4"
    part = client.get(path, headers={"Range": "bytes=0-1"})
    assert part.status_code == 206 and part.content == whole.content[:2]
    assert part.headers["content-range"] == f"bytes 0-1/{len(whole.content)}"
    tail = client.get(path, headers={"Range": "bytes=-10"})
    assert tail.status_code == 206 and tail.content == whole.content[-10:]
    assert client.get(path, headers={"Range": f"bytes={len(whole.content)}-"}).status_code == 416
    assert client.head(path).content == b""


def test_a_video_that_is_changed_while_serving_is_not_shown(rater, study):
    client, _ = rater
    name = due(client.get("/page"))
    study.video(name).write_bytes(b"another video")
    page = client.get(f"/stimuli/{name}.mp4")
    assert page.status_code == 503 and name in page.text


def test_a_fault_says_nothing_of_the_inside(site, monkeypatch):
    from starlette.testclient import TestClient

    from reports.study.app import make_app

    client, made = site()
    begin(client)

    def fail(*_, **__):
        raise RuntimeError("a secret detail")

    monkeypatch.setattr(made.store, "show", fail)
    outside = TestClient(make_app(made), base_url="http://study.test", raise_server_exceptions=False)
    outside.cookies = client.cookies
    page = outside.get("/page")
    assert page.status_code == 500 and "secret detail" not in page.text
    assert page.headers["content-security-policy"] == HEADERS["Content-Security-Policy"]
