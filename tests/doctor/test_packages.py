"""Versions, bounds, and two packages that exclude each other."""

from __future__ import annotations

import sys
from importlib import metadata
from pathlib import Path

import pytest

from haim_torchrl.doctor import packages


def install(folder: Path, name: str, version: str) -> None:
    """What pip leaves of a package, without its code."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which Python looks for packages first."""
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_bounds(site: Path) -> None:
    install(site, "gearbox", "1.5.0")
    wanted = ["gearbox>=1.2,<2", "gearbox>=2", "gearbox<1.5", "clutch>=3", "gearbox"]
    found = packages.required_packages(wanted)
    assert [check.status for check in found] == ["ok", "fail", "fail", "fail", "ok"]
    assert found[1].detail == "1.5.0 is installed; >=2 is needed"
    assert found[1].fix == 'pip install "gearbox>=2"'
    assert found[3].detail == "not installed; >=3 is needed"


def test_requirements_of_extras_and_other_pythons_do_not_count(site: Path) -> None:
    wanted = ['clutch>=3; extra == "dev"', 'clutch>=3; python_version < "3.0"']
    assert packages.required_packages(wanted) == []


def test_this_package_has_what_it_needs() -> None:
    found = packages.required_packages()
    assert {"torch", "torchrl", "rich"} <= {check.name for check in found}
    assert [check for check in found if check.status != "ok"] == []


def test_python_too_old() -> None:
    assert packages.python_version().status == "ok"
    check = packages.python_version(">=99")
    assert check.status == "fail" and ">=99 is needed" in check.detail


def test_pygame_alone_is_fine() -> None:
    check = packages.pygame()
    assert check.status == "ok"
    assert check.detail == f"pygame-ce {metadata.version('pygame-ce')}"


def test_pygame_twice(site: Path) -> None:
    install(site, "pygame", "2.6.1")
    check = packages.pygame()
    assert check.status == "warn"
    assert "pygame 2.6.1 are both installed" in check.detail
    assert check.fix.startswith("pip uninstall --yes pygame, then")


def test_pygame_that_cannot_be_imported(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(site, "pygame", "2.6.1")
    (site / "pygame").mkdir()
    (site / "pygame" / "__init__.py").write_text("import no_such_half\n")
    for name in [name for name in sys.modules if name.split(".")[0] == "pygame"]:
        monkeypatch.delitem(sys.modules, name)
    check = packages.pygame()
    assert check.status == "fail"
    assert "no_such_half" in check.detail


def test_optional_packages_are_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "OPTIONAL", (("clutch", "changing gear", "clutch"),))
    (check,) = packages.optional_packages()
    assert (check.status, check.fix) == ("info", 'pip install "clutch"')
    assert check.detail == "not installed; only changing gear needs it"


def test_a_package_that_cannot_be_imported(site: Path) -> None:
    (site / "clutch_plate.py").write_text("raise ImportError('libclutch.so is missing')\n")
    (check,) = packages.imports(("json", "clutch_plate"))
    assert check.status == "fail"
    assert check.detail == "cannot be imported: ImportError: libclutch.so is missing"
    assert check.fix == "pip install --force-reinstall clutch-plate"
    assert [found.status for found in packages.imports()] == ["ok"]
