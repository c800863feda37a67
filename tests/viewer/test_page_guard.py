"""The studio answers its own page: what a foreign one, or one without the token, gets instead."""

from __future__ import annotations

import re
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from urllib.parse import urlsplit

import pytest

viser = pytest.importorskip("viser", reason='the studio needs the "view" extra')
from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from pb4u.viewer.studio import Studio  # noqa: E402

PROTOCOL = f"viser-v{viser.__version__}"


@pytest.fixture(scope="module")
def local() -> Iterator[Studio]:
    studio = Studio(port=0)
    yield studio
    studio.close()


@pytest.fixture(scope="module")
def shared() -> Iterator[Studio]:
    studio = Studio(host="0.0.0.0", port=0)
    yield studio
    studio.close()


def port(studio: Studio) -> int:
    return urlsplit(studio.url).port or 0


def socket_opens(studio: Studio, origin: str | None, host: str | None = None, **headers: str) -> bool:
    """Whether a websocket is let in, and a message comes through it."""
    place = host or f"localhost:{port(studio)}"
    given = {**headers, **({"Host": host} if host else {})}
    try:
        with connect(
            f"ws://{place if host is None else f'localhost:{port(studio)}'}", origin=origin, subprotocols=[PROTOCOL],
            additional_headers=given, max_size=None,
        ) as page:  # fmt: skip
            return bool(page.recv(timeout=10))
    except InvalidStatus as refused:
        return refused.response.status_code != 403


def answer(studio: Studio, path: str = "/", **headers: str) -> tuple[int, str, dict[str, str]]:
    request = urllib.request.Request(f"http://localhost:{port(studio)}{path}", headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=10) as given:
            return given.status, given.read().decode("utf-8", "replace"), dict(given.headers)
    except urllib.error.HTTPError as refused:
        return refused.code, refused.read().decode(), dict(refused.headers)


def test_its_own_page_is_answered(local: Studio) -> None:
    for name in ("localhost", "127.0.0.1"):
        assert socket_opens(local, f"http://{name}:{port(local)}") is (name == "localhost")
    status, page, headers = answer(local)
    assert status == 200
    assert "<html" in page
    assert headers["X-Frame-Options"] == "DENY"
    assert "token" not in local.url


def test_a_port_that_leads_here_from_elsewhere_is_answered(local: Studio) -> None:
    # As by `ssh -L 9000:localhost:8094`: the browser knows the other end only.
    assert answer(local, Host="localhost:9000")[0] == 200
    assert answer(local, Host=f"127.0.0.2:{port(local)}")[0] == 200


@pytest.mark.parametrize(
    "origin",
    ["https://example.org", "http://localhost", "http://localhost:1", "null", "http://localhost.example.org", None],
)
def test_a_foreign_page_is_refused_before_any_message(local: Studio, origin: str | None) -> None:
    assert not socket_opens(local, origin)


def test_a_name_made_to_point_here_is_refused(local: Studio) -> None:
    host = f"example.org:{port(local)}"
    status, sentence, _ = answer(local, Host=host)
    assert status == 403
    assert "only on this machine" in sentence
    request = urllib.request.Request(f"http://localhost:{port(local)}/", headers={"Origin": "https://example.org"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(request, timeout=10)


def test_from_elsewhere_the_token_is_asked_for(shared: Studio) -> None:
    token = re.search(r"/\?token=([\w-]{32,})$", shared.url)
    assert token is not None
    origin = f"http://localhost:{port(shared)}"
    assert answer(shared)[0] == 403
    assert answer(shared, "/?token=guess")[0] == 403
    assert not socket_opens(shared, origin)
    status, _, headers = answer(shared, f"/?token={token[1]}")
    assert status == 200
    cookie = headers["Set-Cookie"]
    assert {"HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}
    shown = cookie.split(";")[0]
    assert answer(shared, Cookie=shown)[0] == 200
    assert socket_opens(shared, origin, Cookie=shown)
    assert not socket_opens(shared, "https://example.org", Cookie=shown)
    assert not socket_opens(shared, origin, Cookie=shown[:-1])


FOREIGN_PAGE = """<!doctype html><title>waiting</title><script>
const socket = new WebSocket("ws://localhost:%d", ["%s"]);
socket.onmessage = () => { document.title = "it answered" };
socket.onerror = () => { if (document.title == "waiting") document.title = "refused" };
</script>"""


@pytest.mark.slow
def test_a_foreign_page_in_a_browser_is_refused(local: Studio, tmp_path) -> None:
    from tests.viewer import test_page

    webdriver = pytest.importorskip("selenium.webdriver")
    if not (test_page.BROWSER and test_page.DRIVER):
        pytest.skip("there is no chromium with its chromedriver here")
    content = (FOREIGN_PAGE % (port(local), PROTOCOL)).encode()

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

    foreign = HTTPServer(("127.0.0.1", 0), Page)
    threading.Thread(target=foreign.serve_forever, daemon=True).start()
    options = webdriver.ChromeOptions()
    options.binary_location = test_page.BROWSER
    for flag in (*test_page.FLAGS, f"--user-data-dir={tmp_path}"):
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(test_page.DRIVER))
    try:
        driver.get(f"http://127.0.0.1:{foreign.server_port}/")
        test_page.wait_for(lambda: driver.title != "waiting", "the page has its answer")
        assert driver.title == "refused"
    finally:
        driver.quit()
        foreign.shutdown()
