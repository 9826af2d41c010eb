"""The page by itself: what it draws, how things move between frames, when it connects again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.human import Figures, Frame, Scene
from haim_torchrl.human.browser import BrowserConsole

Visit = Callable[..., Any]
PIXEL = """([x, y]) => {
  const canvas = document.getElementById("canvas");
  const ratio = canvas.width / canvas.clientWidth;
  const [left, top] = [canvas.clientWidth / 2 + x, 0.62 * canvas.clientHeight + y];
  const pixel = canvas.getContext("2d").getImageData(left * ratio, top * ratio, 1, 1);
  return [...pixel.data.slice(0, 3)];
}"""


def frame(step: int, **entries: Any) -> Frame:
    """The vehicle drives north, one metre a step, with a follower 20 m behind."""
    vehicle = np.array([0.0, float(step), np.pi / 2, 5.0, 2.0])
    follower = np.array([[0.0, step - 20.0, np.pi / 2, 5.0, 2.0]])
    snapshot = Snapshot(
        0.1 * step, vehicle, 10.0, 0.0, follower, np.array([9.5]), np.zeros(1), np.array([15.0])
    )
    return Frame(0, step, snapshot, **entries)


def test_the_vehicle_is_drawn_in_the_colour_of_who_drives(
    console: BrowserConsole, visit: Visit
) -> None:
    edges = [RoadLine(np.array([[x, -100.0], [x, 100.0]])) for x in (-3.0, 3.0)]
    console.begin(Scene(0, ScenarioLabels(26, ("t_junction",), 1), edges))
    console.show(frame(0))
    page = visit(console.address, color_scheme="light")
    metre = page.evaluate("document.getElementById('canvas').clientHeight") / 110.0
    colors = {"agent": [74, 168, 240], "person": [255, 90, 82], "fallback": [255, 210, 63]}
    for step, (driver, color) in enumerate(colors.items(), 1):
        console.show(frame(step, driver=driver))
        page.locator(f"#hud[data-step='{step}']").wait_for(state="attached")
        page.wait_for_timeout(300)
        assert page.evaluate(PIXEL, [0, 0]) == color
    assert page.evaluate(PIXEL, [0, 20 * metre]) == [195, 155, 245]  # the follower, behind
    assert page.evaluate(PIXEL, [0, -20 * metre]) == [76, 83, 89]  # the road, ahead
    assert page.evaluate(PIXEL, [-20 * metre, 0]) == [217, 226, 210]  # beside it
    assert page.locator("#caption").text_content() == (
        "Episode 0 · step 3 · scenario 26 · T-junction · 1 obstacle"
    )
    assert page.locator("#hud-followers").text_content() == "9.5"


def test_figures_are_written_as_people_read_them(console: BrowserConsole, visit: Visit) -> None:
    figures = Figures(1200, 20_000, 3725.2, 12, 9, 2, 31, 0.256)
    console.begin(Scene(0, ScenarioLabels(26), []))
    console.show(
        frame(
            1,
            disturbance=True,
            cost=1.0,
            takeover_cost=0.004,
            disturbance_cost=0.315,
            figures=figures,
            device_ok=False,
            latency_ms=12.4,
            hint="Brake earlier.",
        )
    )
    page = visit(console.address)
    page.locator("#hud[data-step='1']").wait_for(state="attached")
    expected = {
        "takeover": "No",
        "disturbance": "Yes",
        "cost": "1",
        "takeover-cost": "< 0.01",
        "d-cost": "0.32",
        "velocity": "10.0 m/s",
        "successes": "9 of 12",
        "violations": "2",
        "takeover-rate": "25.6 %",
        "takeovers": "31",
        "steps": "1200 / 20000",
        "time-left": "1:02:06",
        "device-ok": "lost",
        "latency": "12 ms",
        "hint": "Brake earlier.",
    }
    shown = {name: page.locator(f"#hud-{name}").text_content() for name in expected}
    assert shown == expected


def test_between_frames_things_move_on_by_at_most_a_step(
    console: BrowserConsole, visit: Visit
) -> None:
    page = visit(console.address)
    places = page.evaluate(
        """async () => {
          const { Motion } = await import("/motion.js");
          const motion = new Motion();
          const frame = (step, x, traffic, notice = null) => ({ episode: 0, step, notice,
            vehicle: [x, 0, 0, 5, 2], followers: [], obstacles: [], traffic });
          motion.take(frame(1, 10, [[50, 4, 0, 5, 2]]), 0);
          motion.take(frame(2, 12, [[90, 4, 0, 5, 2], [51, 4, 0, 5, 2]]), 100);
          const at = (now) => {
            const { vehicle, traffic } = motion.at(now);
            return [vehicle[0], traffic.map((box) => box[0])];
          };
          const seen = [at(100), at(150), at(900)];
          motion.take(frame(2, 12, [], "paused"), 200);
          return [...seen, at(250)];
        }"""
    )
    # Of the traffic one vehicle is new, and nobody knows yet how it moves.
    assert places == [[12, [90, 51]], [13, [90, 51.5]], [14, [90, 52]], [12, []]]


def test_a_page_outlives_its_run_and_says_why_it_cannot_come_back(visit: Visit) -> None:
    console = BrowserConsole(port=0, token="first")
    console.open()
    page = visit(console.address)
    console.close()
    title = page.locator("#banner-title")
    page.locator("#banner-title", has_text="The run has ended.").wait_for()
    page.wait_for_timeout(2500)  # by then it has tried to connect again
    assert title.text_content() == "The run has ended."
    port = int(console.address.split(":")[-1].partition("/")[0])
    again = BrowserConsole(port=port, token="first")
    again.open()
    page.locator("#link[data-state=open]").wait_for()
    again.close()
    other = BrowserConsole(port=port, token="second")
    other.open()
    try:
        page.locator("#banner-text", has_text="The token is wrong").wait_for()
        assert title.text_content() == "Disconnected"
    finally:
        other.close()


@pytest.mark.parametrize("size", [(1280, 720), (1024, 640), (390, 780), (844, 390)])
def test_everything_fits_the_screen(
    console: BrowserConsole, visit: Visit, size: tuple[int, int]
) -> None:
    console.begin(Scene(0, ScenarioLabels(26, ("roundabout",) * 3, 2), []))
    console.show(frame(1, takeover_cost=0.96, notice="paused"))
    width, height = size
    page = visit(console.address, viewport={"width": width, "height": height})
    page.locator("#hud[data-step='1']").wait_for(state="attached")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate("document.documentElement.scrollHeight") <= height
    spilling = page.evaluate(
        """() => [...document.querySelectorAll(".tile, #run div, button, #banner")]
          .filter((box) => box.scrollWidth > box.clientWidth + 1).map((box) => box.textContent)"""
    )
    assert spilling == []
