"""Pages in headless Chromium, light, dark, and as narrow as a phone: no message on the console, no request, nothing wider than the
window, no plot that moves under the cross-hair, and nothing that axe-core (fetched by npm) finds against WCAG AA. In a page beside a signals.csv the cross-hair is moved to
samples of the position, by mouse and by keys, and what it reads is compared with the table. `--pictures` names a folder for
pictures of the pages."""

import base64
import csv
import json
import os
import subprocess
import tarfile

import pytest
from conftest import ROOT, only

AXE = "axe-core@4.14.1"
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-default-apps", "--hide-scrollbars", "--remote-debugging-pipe",
    # The browser itself asks no server either.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
]
# Width and colour scheme of each view.
VIEWS = {"light": (1300, "light"), "dark": (1300, "dark"), "narrow": (420, "light"), "narrow-dark": (420, "dark")}
# Part of an axis by which a value may differ from the table.
RESOLUTION = 1 / 60_000


class Browser:
    """Chromium, led through a pair of pipes by the protocol of its developer tools."""

    def __init__(self, folder):
        to_browser, from_us = os.pipe()
        to_us, from_browser = os.pipe()
        keep = [(to_browser, 3), (from_browser, 4)]

        def take_pipes():
            # Both numbers may be taken by one of the pipes itself.
            copies = [(os.dup2(os.dup(own), 100 + number), number) for own, number in keep]
            for copy, number in copies:
                os.dup2(copy, number)

        command = ["chromium", *FLAGS, f"--user-data-dir={folder}", "about:blank"]
        self.process = subprocess.Popen(command, preexec_fn=take_pipes, close_fds=False, stderr=subprocess.DEVNULL)
        os.close(to_browser)
        os.close(from_browser)
        self.output, self.input = os.fdopen(from_us, "wb", 0), os.fdopen(to_us, "rb", 0)
        self.rest, self.number, self.events, self.session = b"", 0, [], None
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def message(self):
        while b"\0" not in self.rest:
            read = os.read(self.input.fileno(), 1 << 20)
            if not read:
                raise ConnectionError("Chromium has ended")
            self.rest += read
        text, self.rest = self.rest.split(b"\0", 1)
        return json.loads(text)

    def ask(self, method, **parameters):
        self.number += 1
        question = {"id": self.number, "method": method, "params": parameters}
        if self.session:
            question["sessionId"] = self.session
        self.output.write(json.dumps(question).encode() + b"\0")
        while (answer := self.message()).get("id") != self.number:
            self.events.append(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def open(self, address):
        """Shows a page, and forgets the one before."""
        self.events.clear()
        self.ask("Page.navigate", url=address)
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            self.events.append(self.message())

    def run(self, script):
        """The value of a script, which may be a promise."""
        answer = self.ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{answer['exceptionDetails']} in {script[:200]}")
        return answer["result"].get("value")

    def look(self, width, scheme):
        self.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)

    def medium(self, name):
        self.ask("Emulation.setEmulatedMedia", media=name)

    def picture(self, place, width):
        height = min(self.run("document.documentElement.scrollHeight"), 12_000)
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        shot = self.ask("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        place.write_bytes(base64.b64decode(shot["data"]))
        return place.stat().st_size

    def mouse(self, kind, x, y, **more):
        self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def key(self, name, **more):
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=name, code=name, **more)

    def drawn(self):
        """Waits until what was asked for is drawn."""
        self.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")

    def complaints(self, url):
        for event in self.events:
            method, parameters = event.get("method"), event.get("params", {})
            if method in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
                yield f"console: {json.dumps(parameters)[:300]}"
            asked = parameters.get("request", {}).get("url", url)
            if method == "Network.requestWillBeSent" and asked != url and not asked.startswith("data:"):
                yield f"asks for {asked}"

    def end(self):
        try:
            self.session = None
            self.ask("Browser.close")
        except (ConnectionError, BrokenPipeError):
            pass
        self.process.wait(30)


def axe(folder):
    """The script of axe-core, fetched by npm."""
    packed = subprocess.run(["npm", "pack", "--silent", AXE], cwd=folder, capture_output=True, text=True, check=True).stdout.strip()
    with tarfile.open(folder / packed) as package:
        return package.extractfile("package/axe.min.js").read().decode()


def findings(browser, script):
    """The findings of axe-core, one line for each rule."""
    browser.run(script + ";1")
    run = """axe.run(document, {resultTypes: ["violations"], runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]})
        .then((found) => found.violations.map((rule) => [rule.id, rule.help, rule.nodes.length, rule.nodes[0].html.slice(0, 160),
            (rule.nodes[0].any[0] || {}).message]))"""
    for found in browser.run(run):
        yield "axe: {}: {} ({} times): {} {}".format(*found)


# Elements that are wider than their place, so that one must scroll sideways.
WIDER = """[document.documentElement, ...document.querySelectorAll(".wide, pre, dl, figure")]
    .filter((one) => one.scrollWidth > one.clientWidth + 1)
    .map((one) => `${one.tagName} ${one.scrollWidth} > ${one.clientWidth}: ${one.textContent.slice(0, 60)}`)"""

# Folded text that is not printed.
UNPRINTED = """[...document.querySelectorAll("details > :not(summary)")].filter((one) => !one.checkVisibility())
    .map((one) => one.textContent.slice(0, 60))"""

# Plots that move when the cross-hair comes.
MOVED = """(async () => {
    const moved = [];
    for (const figure of document.querySelectorAll("figure.plot")) {
        const svg = figure.querySelector("svg");
        svg.scrollIntoView({block: "center"});
        const {left, top, width, height} = svg.getBoundingClientRect();
        const middle = {bubbles: true, clientX: left + width / 2, clientY: top + height / 2};
        svg.dispatchEvent(new PointerEvent("pointermove", middle));
        await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
        const by = svg.getBoundingClientRect().top - top;
        if (Math.abs(by) > 1) moved.push(`${figure.querySelector("strong").textContent} by ${by} pixels`);
        figure.querySelector(".axes").dispatchEvent(new PointerEvent("pointerleave"));
        await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    }
    return moved;
})()"""

# A sample of the first curve of a plot: where it is on the screen, and the stretch and height that its axes have.
SAMPLE = """(() => {
    const figure = [...document.querySelectorAll("figure.plot:not(.plane)")].find((one) =>
        [...one.querySelectorAll(".legend button")].some((key) => key.firstChild.nextSibling.textContent === "measured"));
    const keys = [...figure.querySelectorAll(".legend button")];
    const number = keys.findIndex((key) => key.firstChild.nextSibling.textContent === "measured");
    const path = figure.querySelectorAll("path:not(.grid)")[number];
    let x = 0, y = 0;
    const all = [];
    for (const [, start, text] of path.getAttribute("d").matchAll(/(M?)([^M]+)/g)) {
        const numbers = text.match(/-?\\d+/g).map(Number);
        if (start) x = y = 0;
        for (let place = 0; place + 1 < numbers.length; place += 2) { x += numbers[place]; y += numbers[place + 1]; all.push([x, y]); }
    }
    const [left, right, bottom, top] = figure.dataset.view.split(" ").map(Number);
    figure.dataset.sampled = "";
    figure.scrollIntoView({block: "center"});
    const box = figure.querySelector("svg").getBoundingClientRect();
    const at = all[Math.floor(all.length * SHARE)];
    return {left, right, bottom, top, number, title: figure.querySelector("strong").textContent,
        x: box.left + at[0] / 64000 * box.width, y: box.top + box.height / 2,
        box: [box.left, box.top, box.width, box.height]};
})()"""
READ = """(() => {
    const figure = document.querySelector("[data-sampled].pointed");
    return {stamp: figure.querySelector(".hair span").textContent,
        value: figure.querySelectorAll(".legend b")[NUMBER].textContent,
        spoken: document.querySelector("[aria-live]").textContent,
        pointed: document.querySelectorAll("figure.pointed").length};
})()"""


def number(text):
    return float(text.replace("\u2212", "-").replace("\u2248", "").split()[0])


def reads_the_table(browser, table):
    """Moves the cross-hair to samples of the measured position, zooms, and compares with the rows of the table."""
    with open(table, newline="") as file:
        rows = list(csv.DictReader(file))
    times = [float(row["time_seconds"]) for row in rows]
    column = next(name for name in rows[0] if name.split(".")[-1].startswith("position_"))
    values = [float(row[column] or "nan") for row in rows]

    def differs(read, sample, way):
        time, value = number(read["stamp"]), number(read["value"])
        width, height = sample["right"] - sample["left"], sample["top"] - sample["bottom"]
        # The cross-hair is on a sample of some curve. Of another one it shows the nearest sample and says so.
        far = width / 800 if read["value"].startswith("\u2248") else RESOLUTION * width
        rows = [row for row in range(len(times)) if abs(times[row] - time) <= far + 1e-9]
        if not any(abs(values[row] - value) <= RESOLUTION * height for row in rows):
            yield f"{way}: {read['value']} at {read['stamp']}, in the table {[values[row] for row in rows[:3]]}"
        return not read["value"].startswith("\u2248")

    exact = 0
    for share in (0.1, 0.35, 0.6, 0.85, 0.97):
        sample = browser.run(SAMPLE.replace("SHARE", str(share)))
        read = READ.replace("NUMBER", str(sample["number"]))
        browser.mouse("mouseMoved", sample["x"], sample["y"])
        browser.drawn()
        exact += yield from differs(browser.run(read), sample, "mouse")
        browser.run("document.querySelector('[data-sampled] .axes').focus()")
        for name in ("ArrowRight", "ArrowRight", "ArrowLeft"):
            browser.key(name)
            browser.drawn()
            found = browser.run(read)
            exact += yield from differs(found, sample, name)
            if found["value"] not in found["spoken"] or found["stamp"] not in found["spoken"]:
                yield f"spoken is {found['spoken']!r}, shown {found['value']} at {found['stamp']}"
    if exact < 5:
        yield f"only {exact} of 20 places are samples"
    if found["pointed"] < 2:
        yield "the cross-hair is in one plot alone"
    left, top, width, height = sample["box"]
    middle = top + height / 2
    for kind, part in (("mousePressed", 0.25), ("mouseMoved", 0.5), ("mouseReleased", 0.5)):
        browser.mouse(kind, left + part * width, middle, button="left", buttons=1, clickCount=1)
    browser.drawn()
    zoomed = browser.run("document.querySelectorAll('figure.zoomed').length")
    if zoomed < 2:
        yield f"a drag zooms {zoomed} plots"
    browser.mouse("mouseMoved", left + 0.4 * width, middle)
    browser.drawn()
    yield from differs(browser.run(read), sample, "zoomed")
    browser.mouse("mouseWheel", left + 0.4 * width, middle, deltaX=0, deltaY=-100)
    browser.key("Escape")
    browser.drawn()
    if browser.run("document.querySelectorAll('figure.zoomed').length"):
        yield "Escape leaves a zoom"
    browser.run("document.querySelector('.legend button').click()")
    if browser.run("document.querySelectorAll('path.off').length") != 1:
        yield "a name does not take its curve away"
    print(f"    the cross-hair read {exact} samples as in {table.parent.name}/{table.name}")


def faults_of(browser, page, pictures, script):
    url = page.resolve().as_uri()
    name = f"{page.resolve().parent.name}-{page.stem}"
    sizes = {}
    for view, (width, scheme) in VIEWS.items():
        browser.look(width, scheme)
        browser.open(url)
        browser.drawn()
        sizes[view] = browser.picture(pictures / f"{name}-{view}.png", width)
        if sizes[view] < 15_000:
            yield f"{page} ({view}): an empty picture of {sizes[view]} bytes"
        for wide in browser.run(WIDER):
            yield f"{page} ({view}): wider than its place: {wide}"
        for moved in browser.run(MOVED):
            yield f"{page} ({view}): moves under the cross-hair: {moved}"
        # The script of axe-core is no page's, so what it is told is not theirs either.
        complaints = list(browser.complaints(url))
        yield from (f"{page} ({view}): {complaint}" for complaint in complaints)
        yield from (f"{page} ({view}): {found}" for found in findings(browser, script))
    print(f"{page} ({page.stat().st_size} bytes): " + ", ".join(f"{view} {size}" for view, size in sizes.items()))
    browser.medium("print")
    yield from (f"{page}: is not printed: {text}" for text in browser.run(UNPRINTED))
    browser.medium("")
    table = page.parent / "signals.csv"
    for view in ("light", "narrow") if table.exists() else ():
        browser.look(*VIEWS[view])
        browser.open(url)
        yield from (f"{page} ({view}): {fault}" for fault in reads_the_table(browser, table))
        yield from (f"{page} ({view}): {complaint}" for complaint in browser.complaints(url))


@pytest.fixture(scope="session")
def axe_core(tmp_path_factory):
    """The text of axe-core."""
    return axe(tmp_path_factory.mktemp("npm"))


@pytest.fixture
def shows(request, require, axe_core, tmp_path):
    """A function that opens pages, and asserts that they are without fault."""
    require("chromium", "chromium")
    pictures = (request.config.getoption("--pictures") or tmp_path / "pictures").resolve()
    pictures.mkdir(parents=True, exist_ok=True)
    browser = Browser(tmp_path / "profile")

    def shows(*pages):
        assert pages
        faults = [fault for page in pages for fault in faults_of(browser, page, pictures, axe_core)]
        assert not faults, "\n".join(faults)

    yield shows
    browser.end()


@pytest.fixture(scope="session")
def runs(run_folder, told, tmp_path_factory):
    """Folders of runs: a step, a disturbed hold, four loops, a drive that is lost."""
    folder = tmp_path_factory.mktemp("runs")
    scenarios = [ROOT / f"scenarios/{name}.toml" for name in ("fan", "four_drives_courses", "sma_pair_drive_lost")]
    told("simulate", *scenarios, "--quiet", "--output", folder)
    return [run_folder, *sorted(folder.iterdir())]


def test_reports_of_runs(shows, runs):
    shows(*(run / "report.html" for run in runs))


def test_pages_of_several_runs(shows, told, runs, tmp_path):
    overview, compared, coverage = (tmp_path / f"{name}.html" for name in ("overview", "compared", "coverage"))
    told("report", *runs, "--output", overview)
    # A step and another run differ, which ends in 1.
    told("compare", *runs[:2], "--output", compared, code=1)
    # Safety is tested by scenarios that were not played here, which ends in 1.
    requirements = ROOT / "scenarios/requirements.csv"
    told("coverage", *runs, "--requirements", requirements, "--output", coverage, code=1)
    shows(overview, compared, coverage)


def test_the_page_of_torture(shows, told, tmp_path):
    told("torture", ROOT / "scenarios/torture.toml", "--runs", "100", "--quiet", "--output", tmp_path / "tortured")
    shows(only(tmp_path / "tortured") / "report.html")


def test_the_report_of_a_sweep(shows, sweep_folder):
    shows(sweep_folder / "report.html")


def test_the_report_of_the_papers_experiments(shows, told, tmp_path):
    told("reproduce", "--reduced", "--quiet", "--output", tmp_path / "reproduction")
    shows(only(tmp_path / "reproduction") / "report.html")
