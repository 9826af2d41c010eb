"""The machine: processors, memory shared between processes, disk, clock."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import statistics
import tempfile
import time
from pathlib import Path

from haim_torchrl.doctor.check import Check

MIB = 2**20
SHARED_MEMORY = Path("/dev/shm")


def threads() -> Check:
    """How many threads torch uses, and how many cores there are for them."""
    import torch

    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity is not None else os.cpu_count() or 1
    detail = f"torch uses {torch.get_num_threads()} of {cores} cores unless told; recipes use 1"
    return Check("threads", "ok", detail)


def devices() -> list[Check]:
    """A tiny computation on the CPU and on each GPU."""
    import torch

    names = ["cpu", *(f"cuda:{i}" for i in range(torch.cuda.device_count()))]
    found = [_compute(name) for name in names]
    if len(names) > 1:
        return found
    if Path("/proc/driver/nvidia").exists():
        detail = f"there is an NVIDIA GPU, but torch {torch.__version__} does not see it"
        fix = "install the build of torch for your driver: https://pytorch.org/get-started/locally"
        return [*found, Check("cuda", "warn", detail, fix)]
    return [*found, Check("cuda", "info", "no GPU; the recipes are sized for a CPU")]


def _compute(name: str) -> Check:
    import torch

    label = "cpu" if name == "cpu" else f"{name} ({torch.cuda.get_device_name(name)})"
    try:
        total = float((torch.ones(8, 8, device=name) @ torch.ones(8, 8, device=name)).sum())
    except RuntimeError as error:
        first = str(error).splitlines()[0]
        return Check(label, "fail", f"computes nothing: {first}", "device=cpu")
    if total != 512.0:
        return Check(label, "fail", f"computes {total} instead of 512", "device=cpu")
    return Check(label, "ok", "computes")


def prioritised_replay() -> Check:
    """TorchRL's compiled part loads; only prioritised replay needs it."""
    from torchrl.data import PrioritizedSampler

    name = "torchrl's C++ extension"
    try:
        PrioritizedSampler(8, alpha=0.6, beta=0.4)
    except Exception:  # TorchRL raises what it finds, of several types
        return Check(
            name,
            "warn",
            "does not load: PrioritizedSampler cannot be used; no recipe uses it",
            "if you need it, install a torch that this TorchRL was built for, or build TorchRL "
            "from source",
        )
    return Check(name, "ok", "loads; prioritised replay can be used")


def processes(patience: float = 60.0) -> Check:
    """A process can be started afresh, as the workers of the evaluation are.

    Args:
        patience: seconds after which it is given up.
    """
    name, fix = "processes", "stay in one process: eval.workers=1 collector=sync"
    method = multiprocessing.get_start_method()
    child = multiprocessing.get_context("spawn").Process(target=os.getpid)
    began = time.perf_counter()
    try:
        child.start()
        child.join(patience)
        took, code = time.perf_counter() - began, child.exitcode
    except OSError as error:
        return Check(name, "warn", f"none can be started: {error}", fix)
    finally:
        if child.is_alive():
            child.kill()
    if code is None:
        return Check(name, "warn", f"not started within {patience:.0f} s", fix)
    if code != 0:
        return Check(name, "warn", f"a started one ended with code {code}", fix)
    return Check(name, "ok", f"one starts in {took:.1f} s; the default start method is {method}")


def shared_memory(folder: Path = SHARED_MEMORY, enough: int = 256 * MIB) -> Check:
    """Memory that processes share is large enough for tensors between them.

    Args:
        folder: where it is mounted.
        enough: bytes that should be free.
    """
    name = "shared memory"
    if not folder.exists():
        return Check(name, "info", f"there is no {folder} on this system")
    free = shutil.disk_usage(folder).free
    detail = f"{free // MIB} MiB free in {folder}"
    if free >= enough:
        return Check(name, "ok", detail)
    fix = "docker run --shm-size=1g, or sudo mount -o remount,size=1G /dev/shm"
    return Check(name, "warn", f"{detail}: too little for collector=parallel", fix)


def runs_folder(folder: Path = Path("runs")) -> Check:
    """The folder of the runs can be written to, and its disk has room.

    Args:
        folder: it; made by the first run, so that it need not be there.
    """
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    try:
        with tempfile.TemporaryFile(dir=place) as file:
            file.write(b"x")
            file.flush()
    except OSError as error:
        reason = error.strerror or type(error).__name__
        fix = f"start elsewhere, or take hydra.run.dir=<a folder>; or sudo chown -R $USER {place}"
        return Check("runs folder", "fail", f"cannot write to {place}: {reason}", fix)
    free = shutil.disk_usage(place).free
    detail = f"{folder.absolute()}, {free / 2**30:.1f} GiB free"
    if free < 2**30:
        lack: str = f"{detail}: a run needs up to some hundred MiB"
        return Check("runs folder", "warn" if free > 100 * MIB else "fail", lack, "make room")
    return Check("runs folder", "ok", detail)


def clock(naps: int = 10, nap: float = 0.1) -> Check:
    """How late the system wakes a program that sleeps for a step: the pace that a person gets.

    Args:
        naps: how often to try.
        nap: how long to sleep [s].
    """
    late = []
    for _ in range(naps):
        began = time.perf_counter()
        time.sleep(nap)
        late.append(1e3 * (time.perf_counter() - began - nap))
    middle, worst = statistics.median(late), max(late)
    detail = f"wakes {middle:.2f} ms late in the middle, {worst:.2f} ms at worst of {naps}"
    if middle > 5.0 or worst > 30.0:
        fix = "close other programs before driving; steps last 100 ms"
        return Check("clock", "warn", f"{detail}: a person will feel that", fix)
    return Check("clock", "ok", detail)
