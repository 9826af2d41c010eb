"""The command: settings, report, JSON and exit codes."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from haim_torchrl.doctor import Check
from haim_torchrl.doctor.mentors import Row, check_mentor, find_conf, page_address, settings_of
from haim_torchrl.doctor.report import as_json, as_text, healthy

SECTIONS = {
    "packages": [Check("torch", "ok", "2.9"), Check("numba", "warn", "slow", "be patient")],
    "machine": [],
}
BROKEN = {"packages": [Check("torch", "fail", "1.0 is installed", "pip install torch")]}
WHEEL = Row("wheel", False, "no wheel is plugged in", "plug it in")


@pytest.mark.parametrize(
    ("sections", "asked_for", "ok"),
    [
        (SECTIONS, None, True),
        (SECTIONS, Row("expert", True), True),
        (SECTIONS, WHEEL, False),
        (BROKEN, None, False),
        (BROKEN, Row("expert", True), False),
    ],
)
def test_what_counts_as_healthy(
    sections: dict[str, list[Check]], asked_for: Row | None, ok: bool
) -> None:
    assert healthy(sections, asked_for) is ok


def test_json() -> None:
    document = json.loads(as_json(SECTIONS, [WHEEL], False))
    assert document["ok"] is False
    assert document["checks"][1] == {
        "section": "packages",
        "name": "numba",
        "status": "warn",
        "detail": "slow",
        "fix": "be patient",
    }
    assert document["mentors"] == [
        {
            "mentor": "wheel",
            "works": False,
            "why": "no wheel is plugged in",
            "fix": "plug it in",
        }
    ]


def test_text_says_what_does_not_work_and_fits_the_terminal() -> None:
    text = as_text(BROKEN, [WHEEL], False, width=80)
    assert text.endswith("does not work: torch")
    assert "-> pip install torch" in text
    assert as_text(SECTIONS, [WHEEL], False).endswith("does not work: mentor=wheel")
    assert as_text(SECTIONS, [WHEEL], True).endswith("everything that is needed works")
    long = Check("a", "warn", "word " * 60, "mend " * 60)
    text = as_text({"x": [long]}, [Row("wheel", False, "why " * 60, "fix " * 60)], False, width=80)
    assert max(map(len, text.splitlines())) <= 80


def test_colours_are_for_terminals() -> None:
    assert "\033[31mfail" in as_text(BROKEN, [], False, colour=True)
    assert "\033" not in as_text(BROKEN, [], False)


def test_settings_come_from_the_folder_one_works_in(tmp_path: Path) -> None:
    (tmp_path / "conf" / "mentor").mkdir(parents=True)
    (tmp_path / "conf" / "base.yaml").write_text("")
    (tmp_path / "conf" / "haim.yaml").write_text("defaults:\n- mentor: tiller\n- _self_\n")
    (tmp_path / "conf" / "mentor" / "tiller.yaml").write_text(
        "_target_: haim_torchrl.human.HumanMentor\n"
        "console:\n"
        "  _target_: haim_torchrl.human.browser.BrowserConsole\n"
        "  host: 127.0.0.1\n"
        "  port: 0\n"
    )
    conf = find_conf(tmp_path)
    assert conf == tmp_path / "conf"
    assert settings_of("tiller", ["mentor.console.port=7"], conf)["console"]["port"] == 7
    assert check_mentor("tiller", conf=conf) == Row("tiller", True)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        row = check_mentor("tiller", [f"mentor.console.port={port}"], conf)
    assert not row.works
    assert row.why == f"mentor.console.port={port}: the port is in use at 127.0.0.1"
    assert row.fix.startswith("take another one, such as mentor.console.port=")
    unknown = check_mentor("rudder", conf=conf)
    assert not unknown.works and "rudder" in unknown.why


def test_settings_without_a_folder() -> None:
    assert settings_of("wheel")["console"]["device"] == "wheel"
    assert page_address() == ("127.0.0.1", 8765)
    assert check_mentor("expert") == Row("expert", True)


def test_conf_beside_the_package(tmp_path: Path) -> None:
    assert find_conf(tmp_path) == Path(__file__).parents[2] / "conf"
    assert check_mentor("expert", conf=find_conf()) == Row("expert", True)


def doctor(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "SDL_VIDEODRIVER": "dummy"}
    return subprocess.run(
        [sys.executable, "-m", "haim_torchrl.doctor", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_everything_as_json(tmp_path: Path) -> None:
    done = doctor("--json", folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    document = json.loads(done.stdout)
    assert document["ok"] is True
    names = [row["mentor"] for row in document["mentors"]]
    assert names == ["keyboard", "gamepad", "wheel", "browser", "expert"]
    assert document["mentors"][-1]["works"]
    sections = {check["section"] for check in document["checks"]}
    assert sections == {"packages", "optional packages", "machine", "window", "page"}
    assert [check for check in document["checks"] if "the check broke" in check["detail"]] == []
    assert list(tmp_path.iterdir()) == []


def test_port_in_use_fails_for_the_browser(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        setting = f"mentor.console.port={server.getsockname()[1]}"
        done = doctor("--mentor", "browser", setting, folder=tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stdout.rstrip().endswith("does not work: mentor=browser")
    assert "the port is in use" in " ".join(done.stdout.split())


def test_settings_need_a_mentor(capsys: pytest.CaptureFixture[str]) -> None:
    from haim_torchrl.doctor.__main__ import main

    with pytest.raises(SystemExit) as caught:
        main(["mentor.console.port=9000"])
    assert caught.value.code == 2
    assert "settings need a --mentor" in capsys.readouterr().err
