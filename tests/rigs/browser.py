"""A headless browser driven with a mouse and a keyboard, by the DevTools protocol over a pipe."""

from __future__ import annotations

import base64
import json
import os
import select
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-extensions",
    "--remote-debugging-pipe",
)  # fmt: skip
FIND = """
(() => {
  const within = (root, found = []) => {
    for (const e of root.querySelectorAll('*')) { found.push(e); if (e.shadowRoot) within(e.shadowRoot, found); }
    return found;
  };
  window.findAll = (selector, words) => within(document).filter(e => e.matches(selector) && e.getClientRects().length
    && (!words || (e.innerText || e.textContent || '').includes(words)));
  window.fields = label => findAll('input').filter(
    e => (e.getRootNode().querySelector('label')?.textContent || '').startsWith(label));
  window.placed = e => {
    e.scrollIntoView({block: 'center', behavior: 'instant'});
    const b = e.getBoundingClientRect();
    return [b.left, b.top, b.width, b.height];
  };
  window.shown = () => {
    const text = root => [...root.childNodes].map(n => n.nodeType == 3 ? n.textContent
      : n.nodeType != 1 || ['STYLE', 'SCRIPT'].includes(n.tagName) || !(n.getClientRects().length || n.tagName == 'BODY'
      || getComputedStyle(n).display == 'contents') ? '' : n.shadowRoot ? text(n.shadowRoot) : text(n)).join(' ');
    return document.body ? text(document.body) : '';
  };
})()
"""
"""Looks into shadow roots too, where the parts of a page of Bokeh are."""
POINTS = """
(() => {
  const found = [];
  const go = view => {
    if (view.glyph && view.model.glyph.type == 'Scatter') {
      const b = view.plot_view.el.getBoundingClientRect();
      if (b.width) found.push([b.left + view.glyph.sx[0], b.top + view.glyph.sy[0]]);
    }
    for (const child of view.children ? view.children() : []) go(child);
  };
  for (const view of Bokeh.index) go(view);
  return found;
})()
"""
"""Where the first point of every glyph of Bokeh's is in the window."""


class Browser:
    """Chromium; its tabs have nothing in common but the profile."""

    def __init__(self, program: str, profile: Path) -> None:
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()

        words = [program, *OPTIONS, f"--user-data-dir={profile}", "about:blank"]
        ends = f'exec "$0" "$@" 3<&{to_browser} 4>&{from_browser}'  # where the browser expects them
        self._process = subprocess.Popen(
            ["bash", "-c", ends, *words],
            pass_fds=(to_browser, from_browser),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._number, self._rest = 0, b""
        self.events: list[dict[str, Any]] = []

    def call(self, method: str, session: str | None = None, **options: Any) -> dict[str, Any]:
        """Send a command and wait for its answer; events that come before it are kept."""
        self._number += 1
        sent = {"id": self._number, "method": method, "params": options, **({"sessionId": session} if session else {})}
        os.write(self._write, json.dumps(sent).encode() + b"\0")
        while True:
            message = self._next(30.0)
            if message.get("id") == self._number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return dict(message["result"])
            self.events.append(message)

    def _next(self, seconds: float) -> dict[str, Any]:
        while b"\0" not in self._rest:
            if not select.select([self._read], [], [], seconds)[0]:
                raise TimeoutError("the browser does not answer")
            piece = os.read(self._read, 1 << 20)
            if not piece:
                raise ConnectionError("the browser has ended")
            self._rest += piece
        one, _, self._rest = self._rest.partition(b"\0")
        return dict(json.loads(one))

    def tab(self, address: str, width: int = 1280, height: int = 900) -> Tab:
        """A new tab at an address."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        return Tab(self, session, address, width, height)

    def close(self) -> None:
        """End the browser."""
        self.call("Browser.close")
        self._process.wait(10)
        os.close(self._write)
        os.close(self._read)


class Tab:
    """One page, with what it asked servers for and what it wrote to its console."""

    def __init__(self, browser: Browser, session: str, address: str, width: int, height: int) -> None:
        self._browser, self._session = browser, session
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._call(f"{domain}.enable")
        self.resize(width, height)
        self._call("Page.addScriptToEvaluateOnNewDocument", source=FIND)
        self._call("Page.navigate", url=address)

    def _call(self, method: str, **options: Any) -> dict[str, Any]:
        return self._browser.call(method, self._session, **options)

    def resize(self, width: int, height: int) -> None:
        """Give the window another size."""
        self._call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )

    def run(self, script: str) -> Any:
        """Value of an expression on the page."""
        found = self._call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(json.dumps(found["exceptionDetails"])[:500])
        return found["result"].get("value")

    def wait(self, truth: Callable[[], Any], what: str, seconds: float = 60.0) -> Any:
        """Ask again until something is true."""
        end = time.monotonic() + seconds
        while not (value := truth()):
            if time.monotonic() > end:
                raise TimeoutError(f"waited {seconds:g} s for {what}; the page shows: {self.text()[-2000:]}")
            time.sleep(0.05)
        return value

    def text(self) -> str:
        """All that can be read on the page."""
        return " ".join(str(self.run("window.shown ? shown() : ''")).split())

    def wait_for(self, words: str, seconds: float = 60.0) -> str:
        """The page's text once it holds some words."""
        return str(self.wait(lambda: words in (text := self.text()) and text, repr(words), seconds))

    def settle(self, seconds: float = 1.5) -> None:
        """Wait until the page and what scrolls in it have kept their height for some time: nothing moves any more."""
        heights = [-1, 0]
        while heights[-1] != heights[-2]:
            time.sleep(seconds)
            heights.append(int(self.run("Math.max(...findAll('*').map(e => e.scrollHeight))")))

    def place(self, selector: str, words: str = "", number: int = 0) -> tuple[float, float, float, float]:
        """Left, top, width and height of an element in the window, scrolled to where it can be seen."""
        return self._place(f"findAll({json.dumps(selector)}, {json.dumps(words)})", number)

    def _place(self, found: str, number: int) -> tuple[float, float, float, float]:
        """Found, scrolled to and measured at one moment: the page may be drawn again at any other."""
        script = f"window.findAll && {found}[{number}] ? placed({found}[{number}]) : null"
        return (*map(float, self.wait(lambda: self.run(script), found)),)  # type: ignore[return-value]

    def mouse(self, kind: str, x: float, y: float, **options: Any) -> None:
        """One event of the mouse: mouseMoved, mousePressed, mouseReleased, mouseWheel."""
        button = {"button": "left", "clickCount": 1} if kind in ("mousePressed", "mouseReleased") else {}
        self._call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button, **options)

    def click(self, selector: str, words: str = "", number: int = 0, *, ctrl: bool = False) -> None:
        """Move to the middle of an element and click."""
        self._click(self.place(selector, words, number), modifiers=2 * ctrl)

    def _click(self, box: tuple[float, float, float, float], **options: Any) -> None:
        left, top, width, height = box
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.mouse(kind, left + width / 2, top + height / 2, **options)

    def point_at(self, words: str) -> None:
        """Point at the first points of the figures, one after the other, until the page says these words."""

        def told() -> bool:
            for x, y in self.run(POINTS):
                for step in (-30.0, 1.0):  # from beside it
                    self.mouse("mouseMoved", x + step, y)
                time.sleep(0.3)
                if words in self.text():
                    return True
            return False

        self.place("canvas")
        self.wait(told, f"{words!r} where the mouse points")

    def choose(self, words: str) -> None:
        """Choose the option that begins so in the list that has one."""
        options = "findAll('select').flatMap(e => [...e.options])"
        put = "const e = o.closest('select'); e.value = o.value; e.dispatchEvent(new Event('change'));"
        self.run(f"(o => {{ {put} }})({options}.find(o => o.textContent.startsWith({json.dumps(words)})))")

    def drag(self, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """Press, move in a few steps, release."""
        self.mouse("mouseMoved", *begin)
        self.mouse("mousePressed", *begin)
        for step in range(1, 6):
            here = [a + (b - a) * step / 5 for a, b in zip(begin, end, strict=True)]
            self.mouse("mouseMoved", here[0], here[1], buttons=1)
        self.mouse("mouseReleased", *end)

    def write(self, label: str, text: str) -> None:
        """Click into the field whose label begins so and write, in place of what stands there; leave it by Enter."""
        self._click(self._place(f"fields({json.dumps(label)})", 0))
        self._call("Input.dispatchKeyEvent", type="keyDown", key="a", code="KeyA", modifiers=2, commands=["selectAll"])
        self._call("Input.insertText", text=text)
        for kind in ("keyDown", "keyUp"):
            self._call(
                "Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13, text="\r"
            )

    def downloads_to(self, folder: Path) -> None:
        """Files that are downloaded go there."""
        self._browser.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))

    def picture(self, path: Path, *, whole: bool = False) -> None:
        """A picture of the window, or of the whole page."""
        found = self._call("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))

    def _events(self, method: str) -> list[dict[str, Any]]:
        self.run("1")  # brings in what has happened
        own = [event for event in self._browser.events if event.get("sessionId") == self._session]
        return [event["params"] for event in own if event["method"] == method]

    @property
    def requests(self) -> list[str]:
        """Addresses that the page asked for, with those of its sockets."""
        asked = [event["request"]["url"] for event in self._events("Network.requestWillBeSent")]
        return [*asked, *(event["url"] for event in self._events("Network.webSocketCreated"))]

    @property
    def complaints(self) -> list[str]:
        """Errors and warnings on the console."""
        said = [
            " ".join(str(part.get("value", part.get("description"))) for part in event["args"])
            for event in self._events("Runtime.consoleAPICalled")
            if event["type"] in ("error", "warning")
        ]
        thrown = [json.dumps(event["exceptionDetails"]) for event in self._events("Runtime.exceptionThrown")]
        logged = [event["entry"]["text"] for event in self._events("Log.entryAdded")]
        return [*said, *thrown, *logged]
