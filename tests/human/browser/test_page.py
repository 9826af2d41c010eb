"""A person drives the real environment in a real browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from haim_torchrl.human import Brake, PersonQuit

from .rig import AGENT, Run

Start = Callable[..., Run]
Visit = Callable[..., Any]
PAD = """
window.pad = { id: "PAD_ID", index: 0, connected: true, mapping: "PAD_MAPPING", timestamp: 1,
  axes: [0, 0, 0, 0], buttons: Array.from({ length: 17 }, () => ({ value: 0, pressed: false })) };
navigator.getGamepads = () => [window.pad, null];
"""
STANDARD_PAD = PAD.replace("PAD_ID", "Pad").replace("PAD_MAPPING", "standard")
WHEEL = PAD.replace("PAD_ID", "G29 Driving Force Racing Wheel (046d-c24f)").replace(
    "PAD_MAPPING", ""
)


def person(step: dict[str, Any]) -> bool:
    return step["intervention"] == [True]


def starts(steps: list[dict[str, Any]]) -> int:
    return sum(step["takeover_start"] == [True] for step in steps)


def check_session(run: Run) -> None:
    """The file says of each step what the step returned."""
    written = list(run.session().steps())
    assert len(written) == len(run.steps) > 0
    for line, step in zip(written, run.steps):
        assert line.action_agent == tuple(step["action_agent"])
        assert line.action_mentor == tuple(step["action_mentor"])
        assert line.action == tuple(step["behavior_action"])
        assert [line.intervention] == step["intervention"]
        assert [line.takeover_start] == step["takeover_start"]
        assert [line.device_ok] == step["device_ok"]


def test_keys_take_over_and_hand_back_and_the_page_says_so(run: Start, visit: Visit) -> None:
    drive = run()
    page = visit(drive.relay.address)
    drive.wait_steps(3)
    assert not any(map(person, drive.steps))
    page.keyboard.down("ArrowLeft")
    drive.wait(lambda: person(drive.steps[-1]))
    drive.wait_steps(8)
    assert page.locator("#driver").text_content() == "You drive"
    page.keyboard.up("ArrowLeft")
    drive.wait(lambda: not person(drive.steps[-1]))
    drive.wait_steps(3)
    page.keyboard.down("Space")  # takes over without moving anything
    drive.wait(lambda: person(drive.steps[-1]))
    page.keyboard.up("Space")
    drive.wait(lambda: not person(drive.steps[-1]))
    drive.wait_steps(3)
    drive.stop()
    steps = drive.steps
    first = next(k for k, step in enumerate(steps) if person(step))
    last = next(k for k, step in enumerate(steps) if k > first and not person(step))
    assert starts(steps[:last]) == 1 and steps[first]["takeover_start"] == [True]
    assert starts(steps) == 2
    # Steered by the key, from the agent's 0.05 to full left; nobody touched the pedals.
    assert min(step["behavior_action"][1] for step in steps[first:last]) == -1.0
    assert all(step["device_ok"] == [True] for step in steps)
    for step in steps[:first] + steps[last : last + 3]:
        assert step["behavior_action"] == pytest.approx(AGENT)
    check_session(drive)
    check_page(page, drive)


def check_page(page: Any, drive: Run) -> None:
    """What the page showed of each step is what the step returned."""
    taken = {(step["episode"], step["step"]): step for step in drive.steps}
    shown = [entry for entry in page.evaluate("window.shown") if entry["step"] > 0]
    assert len(shown) > 0.8 * (len(taken) - shown[0]["step"])
    count = 0
    for entry in shown:
        step = taken[entry["episode"], entry["step"]]
        assert entry["takeover"] == ("Yes" if person(step) else "No")
        assert entry["driver"] == ("person" if person(step) else "agent")
        assert entry["disturbance"] == ("Yes" if step["disturbance"] == [True] else "No")
        assert entry["velocity"] == f"{step['speed'][0]:.1f} m/s"
        assert entry["cost"] == f"{step['cost'][0]:.0f}"
        assert float(entry["takeover-cost value"]) == step["takeover_cost"][0]
        cost = step["takeover_cost"][0]
        assert entry["takeover-cost"] == ("< 0.01" if 0 < cost < 0.005 else f"{cost:.2f}")
        assert float(entry["d-cost value"]) == step["disturbance_cost"][0]
        for place, name in enumerate(("acceleration", "steering")):
            assert float(entry[f"{name}-agent value"]) == step["action_agent"][place]
            assert float(entry[f"{name}-person value"]) == step["action_mentor"][place]
        assert entry["device-ok"] == "works"
        before = [other for key, other in taken.items() if key <= (entry["episode"], entry["step"])]
        assert entry["steps"] == f"{len(before)} / 5000"
        assert entry["takeovers"] == str(starts(before))
        rate = sum(map(person, before)) / len(before)
        assert float(entry["takeover-rate value"]) == pytest.approx(rate)
        count += entry["takeover-cost value"] != "0"
    assert count > 0  # the costs of a takeover were there to be seen


def test_a_gamepad_drives(run: Start, visit: Visit) -> None:
    drive = run(pace=30)
    page = visit(drive.relay.address, STANDARD_PAD)
    drive.wait_steps(5)
    page.evaluate("pad.axes = [0.04, 0, 0, 0]")  # within the dead zone
    drive.wait_steps(6)
    assert not any(map(person, drive.steps))
    page.evaluate("pad.axes = [0.525, 0, 0, 0]; pad.buttons[7] = { value: 0.62, pressed: true }")
    drive.wait(lambda: person(drive.steps[-1]))
    drive.wait_steps(8)
    # Of the range beyond the dead zone of 0.05: (0.525 - 0.05) / 0.95 and (0.62 - 0.05) / 0.95.
    assert drive.steps[-1]["behavior_action"] == pytest.approx([0.6, 0.5])
    assert starts(drive.steps) == 1
    page.evaluate("pad.buttons[6] = { value: 1, pressed: true }")  # the brake wins
    drive.wait(lambda: drive.steps[-1]["behavior_action"][0] == -1.0)
    page.evaluate("pad.axes = [0, 0, 0, 0]; [6, 7].forEach((k) => (pad.buttons[k] = { value: 0 }))")
    drive.wait(lambda: not person(drive.steps[-1]))
    page.evaluate("pad.buttons[4] = { value: 1, pressed: true }")
    drive.wait(lambda: person(drive.steps[-1]))
    assert drive.console.read().kind == "gamepad"
    drive.stop()
    assert starts(drive.steps) == 2


def test_a_wheel_is_set_up_once_and_drives(run: Start, visit: Visit) -> None:
    drive = run(pace=30)
    page = visit(drive.relay.address, WHEEL)
    page.evaluate("pad.axes = [0.1, 0, 0, 0]")
    page.locator("#set-up").click()
    # The wheel rests a little off its middle, the pedals rest at 1 and are pressed at -1.
    page.evaluate("pad.axes = [0.1, 1, 1, 0]")
    page.locator("#mapping-next").click()
    for part in (
        "pad.axes = [-1, 1, 1, 0]",
        "pad.axes = [0.1, -1, 1, 0]",
        "pad.axes = [0.1, 1, -1, 0]",
    ):
        page.evaluate(part)
        page.locator("#mapping-next:enabled").click()
        page.evaluate("pad.axes = [0.1, 1, 1, 0]")
    page.evaluate("pad.buttons[5] = { value: 1, pressed: true }")
    page.locator("#mapping-next:enabled").click()
    page.evaluate("pad.buttons[5] = { value: 0, pressed: false }")
    page.locator("#mapping-dialog").wait_for(state="hidden")
    page.locator("#set-up").wait_for(state="hidden")
    drive.wait_steps(10)
    assert not any(map(person, drive.steps[-5:]))
    page.evaluate("pad.axes = [0.1, 0, 1, 0]")  # half throttle
    drive.wait(lambda: person(drive.steps[-1]))
    reading = drive.console.read()
    assert reading.kind == "wheel" and reading.controls.throttle == pytest.approx(0.5)
    page.evaluate("pad.axes = [-0.45, 1, 1, 0]")  # half to the left
    drive.wait(lambda: drive.console.read().controls.steering == pytest.approx(-0.5))
    page.reload()  # the page remembers; a pedal counts only once it was seen at rest
    page.locator("#link[data-state=open]").wait_for()
    page.evaluate("pad.axes = [0.1, 0, 0, 0]")
    drive.wait(lambda: drive.console.read().kind == "wheel")
    assert drive.console.read().controls.throttle == drive.console.read().controls.brake == 0.0
    page.evaluate("pad.axes = [0.1, 1, 1, 0]")
    page.wait_for_timeout(100)
    page.evaluate("pad.axes = [0.1, 1, -1, 0]")
    drive.wait(lambda: drive.console.read().controls.brake == 1.0)


def test_a_lost_connection_during_a_takeover_and_back(run: Start, visit: Visit) -> None:
    drive = run(fallback=Brake(-0.5))
    page = visit(drive.relay.address)
    drive.wait_steps(2)
    page.keyboard.down("ArrowUp")
    drive.wait(lambda: person(drive.steps[-1]))
    drive.wait_steps(5)
    assert drive.steps[-1]["behavior_action"][0] == 1.0
    drive.relay.cut()
    drive.wait(lambda: not drive.console.read().connected)
    gone = len(drive.steps)  # the step after this one may be under way
    drive.wait_steps(6)
    lost = [k for k, step in enumerate(drive.steps) if step["device_ok"] == [False]]
    assert lost[0] <= gone + 1
    for step in drive.steps[lost[0] :]:
        assert person(step) and step["behavior_action"] == [-0.5, 0.0]
    assert starts(drive.steps) == 1  # it is the same takeover
    page.locator("#banner-title", has_text="Connection lost").wait_for()
    drive.relay.mend()
    drive.wait(lambda: drive.steps[-1]["device_ok"] == [True])
    # The key is still down, but counts only when it is pressed anew.
    drive.wait(lambda: not person(drive.steps[-1]))
    page.keyboard.up("ArrowUp")
    page.keyboard.down("ArrowUp")
    drive.wait(lambda: drive.steps[-1]["behavior_action"][0] == 1.0)
    drive.stop()
    assert starts(drive.steps) == 2
    flags = [step["device_ok"] == [True] for step in drive.steps]
    assert flags == [True] * lost[0] + [False] * flags.count(False) + [True] * (
        len(flags) - lost[0] - flags.count(False)
    )
    check_session(drive)


def test_a_lost_connection_holds_the_run_where_that_is_wanted(run: Start, visit: Visit) -> None:
    drive = run()
    page, watcher = visit(drive.relay.address), visit(drive.relay.address)
    drive.wait_steps(2)
    page.goto("about:blank")
    title = "Connection lost: waiting for the driver"
    watcher.locator("#banner-title", has_text=title).wait_for()
    count = len(drive.steps)
    watcher.wait_for_timeout(300)
    assert len(drive.steps) == count
    assert watcher.locator("#hud-device-ok").text_content() == "lost"
    assert watcher.locator("#hud-role").text_content() == "Nobody drives · 1 watching"
    watcher.locator("#drive").click()
    drive.wait_steps(3)
    assert watcher.locator("#hud-role").text_content() == "You are the driver"
    assert watcher.locator("#banner").is_hidden()


def test_buttons_pause_resume_and_quit(run: Start, visit: Visit) -> None:
    drive = run(pace=30)
    page, watcher = visit(drive.relay.address), visit(drive.relay.address)
    assert watcher.locator("#hud-role").text_content() == "Someone else drives · 1 watching"
    assert watcher.locator("#pause").is_disabled() and watcher.locator("#quit").is_disabled()
    drive.wait_steps(2)
    page.locator("#pause", has_text="Pause").click()
    watcher.locator("#banner-title", has_text="Paused").wait_for()
    count = len(drive.steps)
    page.keyboard.press("Space")  # drives, and presses no button
    page.wait_for_timeout(200)
    assert len(drive.steps) == count
    page.locator("#pause", has_text="Resume").click()
    drive.wait_steps(3)
    assert page.locator("#banner").is_hidden()
    page.locator("#quit").click()
    page.locator("#quit-dialog button", has_text="Go on").click()
    drive.wait_steps(3)
    page.locator("#quit").click()
    page.locator("#quit-yes").click()
    drive.wait(lambda: isinstance(drive.ended, PersonQuit))
    drive.stop()
    page.locator("#banner-title", has_text="The run has ended.").wait_for()
    check_session(drive)


def test_nothing_sticks_when_the_page_is_left(run: Start, visit: Visit) -> None:
    drive = run(pace=30)
    page = visit(drive.relay.address)
    page.keyboard.down("KeyW")
    drive.wait(lambda: drive.console.read().controls.throttle == 1.0)
    page.evaluate("dispatchEvent(new Event('blur'))")
    drive.wait(lambda: drive.console.read().controls.throttle == 0.0)
    page.evaluate("dispatchEvent(new Event('focus'))")
    page.keyboard.down("KeyW")  # repeats, since it was never let go
    drive.wait_steps(5)
    assert drive.console.read().controls.throttle == 0.0
    page.keyboard.up("KeyW")
    page.keyboard.down("KeyW")
    drive.wait(lambda: drive.console.read().controls.throttle == 1.0)
    # A page that nobody sees lets go and falls silent, so that the watchdog sees that nobody is
    # there; a headless browser shows all pages, so the page is told.
    page.evaluate(
        """() => {
          Object.defineProperty(document, "hidden", { get: () => window.away, configurable: true });
          window.away = true;
          document.dispatchEvent(new Event("visibilitychange"));
        }"""
    )
    drive.wait(lambda: drive.console.read().controls.throttle == 0.0)
    drive.wait(lambda: drive.console.read().age > 0.4)
    page.evaluate("window.away = false; document.dispatchEvent(new Event('visibilitychange'))")
    drive.wait(lambda: drive.console.read().age < 0.2)


def test_fingers_drive_on_a_phone(run: Start, visit: Visit) -> None:
    drive = run(pace=30)
    phone = {"viewport": {"width": 390, "height": 780}, "has_touch": True, "is_mobile": True}
    page = visit(drive.relay.address, **phone)
    for name in ("pad", "touch-throttle", "touch-brake", "touch-takeover", "pause", "hud-velocity"):
        place = page.locator(f"#{name}").bounding_box()
        assert place["x"] >= 0 and place["x"] + place["width"] <= 390, name
        assert place["y"] >= 0 and place["y"] + place["height"] <= 780, name
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    touch = page.context.new_cdp_session(page)

    def put(kind: str, *points: tuple[float, float]) -> None:
        at = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    pad, throttle = (page.locator(f"#{name}").bounding_box() for name in ("pad", "touch-throttle"))
    middle = (pad["x"] + pad["width"] / 2, pad["y"] + pad["height"] / 2)
    reach = (pad["width"] - 60) / 2
    thumb = (throttle["x"] + 20, throttle["y"] + 20)
    put("touchStart", middle, thumb)
    drive.wait(lambda: drive.console.read().controls.throttle == 1.0)
    put("touchMove", (middle[0] - reach / 2, middle[1]), thumb)
    drive.wait(lambda: drive.console.read().controls.steering == pytest.approx(-0.5, abs=0.02))
    drive.wait(lambda: person(drive.steps[-1]) and drive.steps[-1]["behavior_action"][1] < -0.4)
    put("touchEnd")
    drive.wait(lambda: drive.console.read().controls.throttle == 0.0)
    assert drive.console.read().controls.steering == 0.0
    drive.wait(lambda: not person(drive.steps[-1]))
