"""Pictures of recorded episodes: top view, platoon diagrams, animation."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from haim_torchrl.evaluation.recording import Episode, RoadLine, Snapshot

COLORS = {
    "vehicle": "#1f77b4",
    "followers": "#8d6bb8",
    "traffic": "#7f8c8d",
    "obstacles": "#e67e22",
    "mentor": "#d62728",
    "edge": "#4a4a4a",
    "marking": "#c4c4c4",
    "route": "#bfe3c5",
}


def corners(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners of oriented boxes.

    Args:
        boxes: ``[n, 5]``: x, y, heading, length, width.

    Returns:
        ``[n, 4, 2]``, in m.

    Example:
        >>> corners(np.array([[0.0, 0.0, 0.0, 4.0, 2.0]]))[0].tolist()
        [[2.0, 1.0], [-2.0, 1.0], [-2.0, -1.0], [2.0, -1.0]]
    """
    boxes = np.asarray(boxes, dtype=float).reshape(-1, 5)
    half = 0.5 * boxes[:, None, 3:5] * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    cos, sin = np.cos(boxes[:, None, 2]), np.sin(boxes[:, None, 2])
    x = boxes[:, None, 0] + cos * half[..., 0] - sin * half[..., 1]
    y = boxes[:, None, 1] + sin * half[..., 0] + cos * half[..., 1]
    return np.stack([x, y], axis=-1)


def _draw_road(axes: Axes, road: Sequence[RoadLine]) -> None:
    for kind, chosen, width, style in (
        ("route", [line for line in road if line.route], 4.0, "solid"),
        ("marking", [line for line in road if not line.route and not line.edge], 0.7, "dashed"),
        ("edge", [line for line in road if not line.route and line.edge], 1.0, "solid"),
    ):
        axes.add_collection(
            LineCollection(
                [np.asarray(line.points)[:, :2] for line in chosen],
                colors=COLORS[kind],
                linewidths=width,
                linestyles=style,
                zorder=0 if kind == "route" else 1,
            )
        )


def _draw_boxes(axes: Axes, snapshot: Snapshot, alpha: float = 1.0, zorder: int = 4) -> None:
    for kind in ("obstacles", "traffic", "followers", "vehicle"):
        boxes = np.asarray(getattr(snapshot, kind)).reshape(-1, 5)
        if len(boxes):
            axes.add_collection(
                PolyCollection(
                    list(corners(boxes)),
                    facecolors=COLORS[kind],
                    edgecolors="black",
                    linewidths=0.3,
                    alpha=alpha,
                    zorder=zorder,
                )
            )


def _draw_trail(axes: Axes, episode: Episode, until: int | None = None) -> None:
    trail = episode.trail[:until]
    if len(trail) < 2:
        return
    flags = np.asarray(episode.interventions[: len(trail) - 1], dtype=bool)
    colors = [COLORS["mentor"] if flag else COLORS["vehicle"] for flag in flags]
    segments = np.stack([trail[:-1], trail[1:]], axis=1)
    axes.add_collection(LineCollection(list(segments), colors=colors, linewidths=1.6, zorder=3))


def _describe(episode: Episode) -> str:
    blocks = ", ".join(episode.labels.blocks)
    ending = episode.outcome.replace("_", " ")
    return f"scenario {episode.labels.index}: {blocks} ({ending} after {episode.times[-1]:.0f} s)"


def top_view(episode: Episode, path: str | os.PathLike[str], scenes: int = 4) -> Path:
    """Draw a whole episode from above: road, path driven, and the cars at a few moments.

    Mentor-driven parts of the path are red. The cars of earlier scenes are paler.

    Args:
        episode: Recorded episode.
        path: Image to write.
        scenes: Moments at which the cars are drawn, evenly spaced, the last at the end.
    """
    points = [np.asarray(line.points)[:, :2] for line in episode.road] + [episode.trail]
    every = np.concatenate(points)
    low, high = every.min(0) - 8.0, every.max(0) + 8.0
    span = np.maximum(high - low, 30.0)
    # Roads are mostly long and thin: the height follows, within what a page can hold.
    figure = Figure(
        figsize=(12, float(np.clip(12 * span[1] / span[0], 2.5, 12))), layout="constrained"
    )
    axes = figure.subplots()
    _draw_road(axes, episode.road)
    _draw_trail(axes, episode)
    last = len(episode.snapshots) - 1
    moments = sorted({round(last * (k + 1) / scenes) for k in range(scenes)})
    for order, moment in enumerate(moments):
        alpha = 0.35 + 0.65 * (order + 1) / len(moments)
        _draw_boxes(axes, episode.snapshots[moment], alpha, zorder=4 + order)
        x, y = episode.snapshots[moment].vehicle[:2]
        axes.annotate(
            f"{episode.times[moment]:.0f} s",
            (x, y),
            xytext=(0, 9),
            fontsize=7,
            textcoords="offset points",
            ha="center",
            zorder=20,
        )
    axes.set(
        xlim=(low[0], high[0]),
        ylim=(low[1], high[1]),
        aspect="equal",
        xlabel="x [m]",
        ylabel="y [m]",
    )
    axes.set_title(_describe(episode), fontsize=9, loc="left")
    figure.savefig(path, dpi=130, bbox_inches="tight")
    return Path(path)


def platoon_figure(
    episodes: Sequence[tuple[str, Episode]],
    path: str | os.PathLike[str],
    brake_limit: float = -5.0,
) -> Path:
    """Position, speed and acceleration of the platoon over time, as the paper's Fig. 10.

    Args:
        episodes: Pairs of a title and an episode; each is a column.
        path: Image to write.
        brake_limit: Threshold lambda of a disturbance in m/s^2, drawn in the last row.
    """
    figure = Figure(figsize=(5.5 * len(episodes), 8), layout="constrained")
    grid = figure.subplots(3, len(episodes), squeeze=False, sharex="col", sharey="row")
    for column, (title, episode) in enumerate(episodes):
        series = (episode.positions(), episode.speeds(), episode.accelerations())
        names = ("position [m]", "speed [m/s]", "acceleration [m/s²]")
        for axes, values, name in zip(grid[:, column], series, names):
            for car in range(values.shape[1] - 1, -1, -1):
                fade = 1.0 - 0.7 * (car - 1) / max(values.shape[1] - 2, 1)
                shade = COLORS["vehicle"] if car == 0 else (0.55, 0.42, 0.72, fade)
                label = "automated vehicle" if car == 0 else ("followers" if car == 1 else None)
                axes.plot(
                    episode.times,
                    values[:, car],
                    lw=1.6 if car == 0 else 0.9,
                    color=shade,
                    label=label,
                    zorder=3 if car == 0 else 2,
                )
            axes.grid(alpha=0.25)
            axes.spines[["top", "right"]].set_visible(False)
            if column == 0:
                axes.set_ylabel(name)
        grid[2, column].axhline(brake_limit, lw=0.8, ls="--", color=COLORS["mentor"])
        grid[2, column].set_xlabel("time [s]")
        grid[0, column].set_title(title, fontsize=9, loc="left")
    grid[0, 0].legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=130)
    return Path(path)


def animate(
    episode: Episode,
    path: str | os.PathLike[str],
    *,
    every: int = 4,
    max_frames: int = 150,
    view: float = 45.0,
    size: tuple[int, int] = (640, 320),
) -> Path:
    """A short film from above that follows the automated vehicle.

    Args:
        episode: Recorded episode.
        path: ``.gif`` or another format that imageio writes.
        every: Steps between frames at least; more if ``max_frames`` would be exceeded.
        max_frames: Upper limit of frames, which bounds size and time.
        view: Metres to each side of the vehicle along x.
        size: Width and height in pixels.
    """
    width, height = size
    stride = max(every, -(-len(episode.snapshots) // max_frames))
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    frames = []
    shown = [*range(0, len(episode.snapshots), stride)]
    if shown[-1] != len(episode.snapshots) - 1:
        shown.append(len(episode.snapshots) - 1)
    for index in shown:
        snapshot = episode.snapshots[index]
        axes.clear()
        axes.set_axis_off()
        _draw_road(axes, episode.road)
        _draw_trail(axes, episode, index + 1)
        _draw_boxes(axes, snapshot)
        x, y = snapshot.vehicle[:2]
        axes.set(
            xlim=(x - view, x + view), ylim=(y - view * height / width, y + view * height / width)
        )
        mentor = bool(episode.interventions[index - 1]) if index else False
        text = f"{snapshot.time:4.1f} s   {snapshot.speed:4.1f} m/s"
        axes.text(
            0.01,
            0.97,
            text + ("   mentor drives" if mentor else ""),
            va="top",
            fontsize=9,
            family="monospace",
            transform=axes.transAxes,
            color=COLORS["mentor"] if mentor else "black",
        )
        canvas.draw()
        frames.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    target = Path(path)
    time_step = float(np.median(np.diff(episode.times))) if len(episode) else 0.1
    # The film runs at twice real time: it shows the drive, and stays short.
    duration = max(round(1000 * time_step * stride / 2), 20)
    if target.suffix == ".gif":
        imageio.imwrite(target, np.stack(frames), duration=duration, loop=0)
    else:
        imageio.imwrite(target, np.stack(frames), fps=1000 / duration)
    return target
