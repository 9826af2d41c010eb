"""A small town in OpenDRIVE, written by hand: two blocks with a road between them.

In OpenDRIVE's frame (y to the left) its roads, each with one 4 m lane per direction, are

    (0, 160) <--- G --- (200, 160) J2 (220, 160) <--- F --- (300, 160)
    H, a curve                     |                            E, a curve
    I, down                        M, up                        D, up
    K, a curve                     |                            C, a curve
    (0, 0)   --- A ---> (200, 0)   J1 (220, 0)   --- B ---> (300, 0)

with curves of radius 30 m and junctions of 20 m, whose turns have a radius of 10 m. Traffic drives
on the right. The arrows are the roads' own directions: their lane -1 goes along, lane 1 against.
"""

from __future__ import annotations

from math import pi

QUARTER = pi / 2

# id: (x, y, heading, length, curvature, predecessor, successor); "j.." names a junction.
ROADS = {
    1: (0, 0, 0, 200, 0.0, (10, "end"), "j100"),  # A
    2: (220, 0, 0, 80, 0.0, "j100", (3, "start")),  # B
    3: (300, 0, 0, 30 * QUARTER, 1 / 30, (2, "end"), (4, "start")),  # C
    4: (330, 30, QUARTER, 100, 0.0, (3, "end"), (5, "start")),  # D
    5: (330, 130, QUARTER, 30 * QUARTER, 1 / 30, (4, "end"), (6, "start")),  # E
    6: (300, 160, pi, 80, 0.0, (5, "end"), "j200"),  # F
    7: (200, 160, pi, 200, 0.0, "j200", (8, "start")),  # G
    8: (0, 160, pi, 30 * QUARTER, 1 / 30, (7, "end"), (9, "start")),  # H
    9: (-30, 130, 3 * QUARTER, 100, 0.0, (8, "end"), (10, "start")),  # I
    10: (-30, 30, 3 * QUARTER, 30 * QUARTER, 1 / 30, (9, "end"), (1, "start")),  # K
    11: (210, 10, QUARTER, 140, 0.0, "j100", "j200"),  # M
}

# id: (junction, x, y, heading, length, curvature, from road, its lane, to road, its lane).
TURNS = {
    101: (100, 200, 0, 0, 20, 0.0, (1, -1), (2, -1)),
    102: (100, 220, 0, pi, 20, 0.0, (2, 1), (1, 1)),
    103: (100, 200, 0, 0, 10 * QUARTER, 0.1, (1, -1), (11, -1)),
    104: (100, 220, 0, pi, 10 * QUARTER, -0.1, (2, 1), (11, -1)),
    105: (100, 210, 10, -QUARTER, 10 * QUARTER, -0.1, (11, 1), (1, 1)),
    106: (100, 210, 10, -QUARTER, 10 * QUARTER, 0.1, (11, 1), (2, -1)),
    201: (200, 220, 160, pi, 20, 0.0, (6, -1), (7, -1)),
    202: (200, 200, 160, 0, 20, 0.0, (7, 1), (6, 1)),
    203: (200, 220, 160, pi, 10 * QUARTER, 0.1, (6, -1), (11, 1)),
    204: (200, 200, 160, 0, 10 * QUARTER, -0.1, (7, 1), (11, 1)),
    205: (200, 210, 150, QUARTER, 10 * QUARTER, 0.1, (11, -1), (7, -1)),
    206: (200, 210, 150, QUARTER, 10 * QUARTER, -0.1, (11, -1), (6, 1)),
}


def town() -> str:
    """The town as OpenDRIVE."""
    roads = [_road(number, *road) for number, road in ROADS.items()]
    turns = [_turn(number, *turn) for number, turn in TURNS.items()]
    junctions = [_junction(number) for number in (100, 200)]
    return (
        '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4" name="" version="1" '
        'north="0" south="0" east="0" west="0"><geoReference>+proj=tmerc +lat_0=0 +lon_0=0'
        "</geoReference></header>" + "".join(roads + turns + junctions)
    ) + "</OpenDRIVE>"


def _shape(x: float, y: float, heading: float, length: float, curvature: float) -> str:
    curve = f'<arc curvature="{curvature}"/>' if curvature else "<line/>"
    return (
        f'<planView><geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}">{curve}'
        "</geometry></planView><elevationProfile/><lateralProfile/>"
    )


def _lane(number: int, kind: str, before: int | None, after: int | None, width: float = 4) -> str:
    link = "" if before is None else f'<predecessor id="{before}"/>'
    link += "" if after is None else f'<successor id="{after}"/>'
    return (
        f'<lane id="{number}" type="{kind}" level="false"><link>{link}</link>'
        f'<width sOffset="0" a="{width}" b="0" c="0" d="0"/></lane>'
    )


def _lanes(left: str, right: str) -> str:
    left = f"<left>{left}</left>" if left else ""
    return (
        f'<lanes><laneSection s="0">{left}<center><lane id="0" type="none" level="false">'
        '<roadMark sOffset="0" type="broken" color="standard" width="0.15" laneChange="both"/>'
        f"</lane></center><right>{right}</right></laneSection></lanes>"
    )


def _neighbour(tag: str, to: object) -> str:
    if isinstance(to, str):
        return f'<{tag} elementType="junction" elementId="{to[1:]}"/>'
    road, end = to
    return f'<{tag} elementType="road" elementId="{road}" contactPoint="{end}"/>'


def _road(number, x, y, heading, length, curvature, before, after) -> str:
    ends = (isinstance(before, str), isinstance(after, str))
    lanes = {
        lane: _lane(lane, "driving", None if ends[0] else lane, None if ends[1] else lane)
        for lane in (1, -1)
    }
    walk = {lane: _lane(lane, "sidewalk", None, None, 2) for lane in (2, -2)}
    return (
        f'<road name="" length="{length}" id="{number}" junction="-1"><link>'
        f"{_neighbour('predecessor', before)}{_neighbour('successor', after)}</link>"
        f"{_shape(x, y, heading, length, curvature)}"
        f"{_lanes(walk[2] + lanes[1], lanes[-1] + walk[-2])}</road>"
    )


def _turn(number, junction, x, y, heading, length, curvature, before, after) -> str:
    ends = {-1: ("end", "start"), 1: ("start", "end")}
    return (
        f'<road name="" length="{length}" id="{number}" junction="{junction}"><link>'
        f"{_neighbour('predecessor', (before[0], ends[before[1]][0]))}"
        f"{_neighbour('successor', (after[0], ends[after[1]][1]))}</link>"
        f"{_shape(x, y, heading, length, curvature)}"
        f"{_lanes('', _lane(-1, 'driving', before[1], after[1]))}</road>"
    )


def _junction(junction: int) -> str:
    connections = "".join(
        f'<connection id="{number}" incomingRoad="{turn[6][0]}" connectingRoad="{number}" '
        f'contactPoint="start"><laneLink from="{turn[6][1]}" to="-1"/></connection>'
        for number, turn in TURNS.items()
        if turn[0] == junction
    )
    return f'<junction id="{junction}" name="">{connections}</junction>'
