"""A session file is read as it was written, or refused."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import warnings
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from haim_torchrl.data import SESSION_FILE, SessionError, SessionWriter, read_session
from haim_torchrl.data.session import FORMAT, encode, seal

FLOATS = st.floats(allow_nan=False, width=32)  # infinities, too
ACTION = st.lists(FLOATS, min_size=2, max_size=2)
STEP = st.fixed_dictionaries(
    {
        "action_agent": ACTION,
        "action_mentor": ACTION,
        "action": ACTION,
        "intervention": st.booleans(),
        "takeover_start": st.booleans(),
        "done": st.booleans(),
        "device_ok": st.booleans(),
        "latency_ms": st.none() | st.floats(0.0, 1e4),
        "policy_version": st.none() | st.integers() | st.text(),
        "observation": st.none() | st.just("00c0ffee"),
    }
)
EPISODE = st.tuples(
    st.none() | st.integers(0, 2**32),
    st.none() | st.just({"state": {"inc": 2**127 + 1}, "uinteger": 3}),
    st.lists(STEP, min_size=1, max_size=3),
)


def write(path: Path, episodes, **header) -> Path:
    with SessionWriter(path, **header) as writer:
        for scenario, random_state, steps in episodes:
            writer.begin_episode(scenario=scenario, random_state=random_state)
            for step in steps:
                writer.add(**step)
    return path


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """Two episodes of two steps; line 1 is the header, lines 2 and 5 begin the episodes."""
    step = {"action_agent": [0.1], "action_mentor": [0.0], "action": [0.1], "intervention": False}
    return write(tmp_path / "short.jsonl", [(7, None, [step] * 2), (8, None, [step] * 2)])


@settings(
    max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
@given(episodes=st.lists(EPISODE, max_size=3), seed=st.none() | st.integers(), text=st.text())
def test_what_is_read_is_what_was_written(tmp_path: Path, episodes, seed, text) -> None:
    path = tmp_path / "session.jsonl"
    path.unlink(missing_ok=True)
    session = read_session(write(path, episodes, seed=seed, settings=text))
    assert session.header["seed"] == seed and session.header["settings"] == text
    assert len(session) == sum(len(steps) for _, _, steps in episodes)
    assert len(session.episodes) == len(episodes)
    for number, (episode, (scenario, random_state, steps)) in enumerate(
        zip(session.episodes, episodes)
    ):
        assert (episode.number, episode.scenario) == (number, scenario)
        assert episode.random_state == random_state
        for index, (read, written) in enumerate(zip(episode.steps, steps)):
            expected = {k: tuple(v) if isinstance(v, list) else v for k, v in written.items()}
            expected |= {"episode": number, "scenario": scenario, "step": index, "time": read.time}
            assert dataclasses.asdict(read) == expected


@given(value=FLOATS)
def test_a_float32_comes_back_exactly(value: float) -> None:
    tensor = torch.tensor([value])
    assert torch.equal(torch.tensor(json.loads(json.dumps(tensor.tolist()))), tensor)


def test_every_line_is_json_and_the_header_explains_it(short: Path) -> None:
    header, *lines = map(json.loads, short.read_text().splitlines())
    assert header["versions"]["torchrl"] and header["started"]
    for line in lines:
        assert set(line) <= set(header["fields"])


def test_a_file_cut_anywhere_keeps_its_whole_steps(short: Path, tmp_path: Path) -> None:
    whole, part = short.read_bytes(), tmp_path / "part.jsonl"
    ends = [i + 1 for i, byte in enumerate(whole) if byte == ord("\n")]
    assert len(ends) == 7
    steps = list(read_session(short).steps())
    for length in range(len(whole) + 1):
        part.write_bytes(whole[:length])
        if length < ends[0]:
            with pytest.raises(SessionError, match="cut before its first step"):
                read_session(part)
            continue
        kept = sum(length >= ends[line] for line in (2, 3, 5, 6))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            session = read_session(part)
        assert list(session.steps()) == steps[:kept]
        said = [str(warning.message) for warning in caught]
        if length in ends:
            assert said == []
        else:
            assert len(said) == 1 and f"the {kept} steps before it are kept" in said[0]
    assert part.read_bytes() == whole  # reading changes nothing


def test_every_changed_byte_is_noticed_and_its_line_named(short: Path, tmp_path: Path) -> None:
    whole, edited = short.read_bytes(), tmp_path / "edited.jsonl"
    for position in range(len(whole) - 1):
        changed = bytearray(whole)
        changed[position] ^= 1
        edited.write_bytes(changed)
        line = whole.count(b"\n", 0, position) + 1
        with pytest.raises(SessionError, match=rf"\bline {line}\b"):
            read_session(edited)


@pytest.mark.parametrize(
    ("order", "line"),
    [
        ([0, 1, 2, 4, 5, 6], 4),  # removed
        ([0, 1, 3, 2, 4, 5, 6], 3),  # exchanged
        ([0, 1, 2, 2, 3, 4, 5, 6], 4),  # repeated
        ([0, 4, 5, 6], 2),
    ],
)
def test_lines_belong_where_they_were_written(short: Path, order: list[int], line: int) -> None:
    lines = short.read_bytes().splitlines(keepends=True)
    short.write_bytes(b"".join(lines[index] for index in order))
    with pytest.raises(SessionError, match=f"line {line} of session .* was edited, removed"):
        read_session(short)


@pytest.mark.parametrize("content", [b"nothing\n", b"{}\n", b"\x80\x00\xff", b"a,b\n1,2\n", b"\n"])
def test_a_foreign_file_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.jsonl"
    path.write_bytes(content)
    with pytest.raises(SessionError, match="not written by this project: its line 1"):
        read_session(path)


def test_a_version_to_come_is_refused(short: Path) -> None:
    short.write_bytes(seal(encode({"format": FORMAT, "version": 2}))[0])
    with pytest.raises(SessionError, match="version 2 but this version of haim_torchrl reads 1"):
        read_session(short)


def test_a_missing_session_is_named_and_a_folder_stands_for_its_session(short: Path) -> None:
    with pytest.raises(SessionError, match=rf"{SESSION_FILE} does not exist"):
        read_session(short.parent)
    short.rename(short.with_name(SESSION_FILE))
    assert len(read_session(short.parent)) == 4


def test_nothing_is_overwritten(short: Path) -> None:
    before = short.read_bytes()
    with pytest.raises(FileExistsError, match="nothing is overwritten"):
        SessionWriter(short)
    assert short.read_bytes() == before


def test_a_step_belongs_to_an_episode(tmp_path: Path) -> None:
    with (
        SessionWriter(tmp_path / "session.jsonl") as writer,
        pytest.raises(ValueError, match="no episode has begun"),
    ):
        writer.add([0.0], [0.0], [0.0], intervention=False)


@pytest.mark.parametrize("kept", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("cut", [0, 1])
def test_a_session_goes_on_after_any_step(short: Path, kept: int, cut: int) -> None:
    before = list(read_session(short).steps())
    os.truncate(short, short.stat().st_size - cut)
    if cut and kept == 4:
        with pytest.raises(SessionError, match="holds 3 steps only, and 4 were driven"):
            SessionWriter.resume(short, kept)
        return
    with SessionWriter.resume(short, kept) as writer:
        assert writer.steps == kept
        writer.begin_episode(scenario=9)
        writer.add([0.5], [0.0], [0.5], intervention=False)
    *first, last = read_session(short).steps()
    assert first == before[:kept]
    assert (last.scenario, last.step, last.action) == (9, 0, (0.5,))
    assert last.episode == (before[kept - 1].episode + 1 if kept else 0)


@pytest.mark.parametrize("kept", [0, 1, 2, 3])
def test_what_follows_a_checkpoint_is_kept_aside(short: Path, kept: int) -> None:
    before = read_session(short)
    SessionWriter.resume(short, kept).close()
    aside = read_session(short.with_name(f"short.after-{kept}.jsonl"))
    assert list(read_session(short).steps()) == list(before.steps())[:kept]
    assert list(aside.steps()) == list(before.steps())[kept:]
    assert aside.header == before.header
    assert [(e.number, e.scenario) for e in aside.episodes] == [(0, 7), (1, 8)][kept // 2 :]


def test_nothing_is_overwritten_by_what_is_kept_aside(short: Path) -> None:
    for number in range(3):
        with SessionWriter.resume(short, 2) as writer:
            writer.begin_episode(scenario=20 + number)
            writer.add([0.0], [0.0], [0.0], intervention=False)
    names = ("short.after-2.jsonl", "short.after-2.2.jsonl", "short.after-2.3.jsonl")
    kept = [read_session(short.with_name(name)).episodes[0].scenario for name in names]
    assert kept == [8, 20, 21]
    assert sorted(path.name for path in short.parent.iterdir()) == sorted([*names, "short.jsonl"])


def test_nothing_to_keep_aside_leaves_no_file(short: Path) -> None:
    SessionWriter.resume(short, 4).close()
    with short.open("ab") as stream:
        stream.write(b'{"episode":2,"scena')  # cut: nobody can read it
    SessionWriter.resume(short, 4).close()
    assert list(short.parent.iterdir()) == [short]
    assert len(read_session(short)) == 4


def test_damaged_steps_are_kept_aside_as_they_are(short: Path) -> None:
    lines = short.read_bytes().splitlines(keepends=True)
    lines[5] = lines[5].replace(b"0.1", b"0.2")
    short.write_bytes(b"".join(lines))
    SessionWriter.resume(short, 2).close()
    assert len(read_session(short)) == 2
    aside = short.with_name("short.after-2.jsonl")
    assert aside.read_bytes() == lines[0] + b"".join(lines[4:])
    with pytest.raises(SessionError, match="is not as it was written"):
        read_session(aside)


def test_a_session_that_is_gone_cannot_go_on(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="is gone"):
        SessionWriter.resume(tmp_path / "session.jsonl", 3)


def test_a_killed_process_loses_no_step(tmp_path: Path) -> None:
    path = tmp_path / "session.jsonl"
    child = os.fork()
    if child == 0:
        writer = SessionWriter(path)
        writer.begin_episode()
        for _ in range(100):
            writer.add([0.0], [0.0], [0.0], intervention=False)
        os.kill(os.getpid(), signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    assert len(read_session(path)) == 100
