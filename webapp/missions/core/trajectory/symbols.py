"""Symbols of detected objects: a frame for what an object means to rescuers, and a glyph for its class.

The frames follow MIL-STD-2525 in shape and colour: a yellow quatrefoil (unknown) for people, a red diamond
for hazards, a blue rectangle for help, a green square for other things. The glyphs are drawn for this
program, in the style of the humanitarian icons of OCHA. A class without a glyph is a plain disc of the
class's colour with its first letter.

All lines are in a box of 32 x 32, x to the right and y down; its middle is the position of the object.
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass

Line = tuple[tuple[float, float], ...]

SIDE = 32.0

_PLAIN_COLOURS = ("#0072b2", "#b26b00", "#00785a", "#a8518a", "#2b7cb3", "#d55e00", "#6b6b00")


@dataclass(frozen=True, slots=True)
class SymbolFrame:
    """A closed outline and its fill colour."""

    outline: Line
    fill: str


@dataclass(frozen=True, slots=True)
class Symbol:
    """A frame with a glyph."""

    words: str  # Regular expression for whole words of its classes, in lower case and without a plural `s`
    frame: SymbolFrame
    glyph: tuple[Line, ...]  # Dark lines

    @property
    def pattern(self) -> str:
        """Regular expression that matches the class in lower case, in Python and JavaScript alike."""
        return rf"(?:^|[^a-z])(?:{self.words})s?(?![a-z])"


def symbol_of(kind: str) -> Symbol | None:
    """Find the symbol of a class of objects; None for a class without one."""
    return next((symbol for symbol in SYMBOLS if re.search(symbol.pattern, kind.lower())), None)


def kind_colour(kind: str) -> str:
    """Return the colour of a class of objects, `#rrggbb`; it is always the same."""
    symbol = symbol_of(kind)
    if symbol is not None:
        return symbol.frame.fill
    first = hashlib.sha256(kind.encode("utf-8", "replace")).digest()[0]
    return _PLAIN_COLOURS[first % len(_PLAIN_COLOURS)]


def svg_path(lines: tuple[Line, ...], *, closed: bool = False) -> str:
    """Write lines as SVG path data."""
    end = "Z" if closed else ""
    return "".join("M" + "L".join(f"{x:g} {y:g}" for x, y in line) + end for line in lines)


def _arc(x: float, y: float, radius: float, *, first: float = 0.0, last: float = 360.0) -> Line:
    """Return an arc of a circle; angles are degrees clockwise from its right."""
    count = max(4, round(abs(last - first) / 15.0))
    angles = (math.radians(first + (last - first) * n / count) for n in range(count + 1))
    return tuple((round(x + radius * math.cos(a), 2), round(y + radius * math.sin(a), 2)) for a in angles)


def _quatrefoil() -> Line:
    leaves = ((16.0, 9.0, 180.0), (23.0, 16.0, 270.0), (16.0, 23.0, 0.0), (9.0, 16.0, 90.0))
    return tuple(p for x, y, first in leaves for p in _arc(x, y, 7.0, first=first, last=first + 180.0))


DISC = _arc(16, 16, 13)
"""Outline for classes without a symbol."""

PEOPLE = SymbolFrame(_quatrefoil(), "#ffff80")
HAZARD = SymbolFrame(((16, 1), (31, 16), (16, 31), (1, 16)), "#ff8080")
HELP = SymbolFrame(((2, 6), (30, 6), (30, 26), (2, 26)), "#80e0ff")
THING = SymbolFrame(((4, 4), (28, 4), (28, 28), (4, 28)), "#aaffaa")

_WHEELS = (_arc(11.5, 21.5, 1.8), _arc(20.5, 21.5, 1.8))
_WAVES: Line = ((8, 16), (11, 13.5), (14, 16), (17, 13.5), (20, 16), (23, 13.5))
_BANG: tuple[Line, ...] = (((16, 9), (16, 18)), ((16, 22), (16, 22.5)))

SYMBOLS = (
    Symbol(r"victim|casualt(?:y|ie)|survivor|injured|wounded|bod(?:y(?! of water)|ie)", PEOPLE,
           (_arc(9.5, 18, 2), ((13, 18), (23, 18)), ((17, 18), (20, 14)), ((7, 22), (25, 22)))),
    Symbol(r"person|personnel|human|people|pedestrian|(?:fire|police|wo)?m[ae]n|child(?:ren)?|rescuer|"
           r"fire.?fighter|paramedic|doctor|nurse|worker|electrician|cyclist|(?:^|bus.|car.|truck.)driver",
           PEOPLE,
           (_arc(16, 10.5, 2.5),
            ((11.5, 23), (11.5, 18), (13.5, 15.5), (18.5, 15.5), (20.5, 18), (20.5, 23)))),
    Symbol(r"gas(?:oline)?|petrol|(?:bio)?chemical|hazmat|toxic|radiation|radioactiv(?:e|ity)|barrel", HAZARD,
           (((14, 8), (18, 8)), ((15, 8), (15, 13), (10.5, 22), (21.5, 22), (17, 13), (17, 8)),
            ((12.5, 18), (19.5, 18)))),
    Symbol(r"extinguisher|fire.?(?:hydrant|hose|blanket|alarm)|smoke.?(?:alarm|detector)", HELP,
           (((13, 24), (13, 14), (15, 12), (17, 12), (19, 14), (19, 24), (13, 24)),
            ((16, 12), (16, 9), (22, 9)), ((12, 9), (16, 9)))),
    Symbol(r"(?:wild|bon|camp)?fire(?!.?(?:exit|escape|door|truck|engine|station))|"
           r"flame|(?:in)?flammable|burning|smoke|heat", HAZARD,
           (((16, 7), (17.5, 12), (20, 15), (20.5, 19), (18.5, 23), (13.5, 23), (11.5, 19), (12, 15.5),
             (14, 17), (14.5, 12), (16, 7)),)),
    Symbol(r"electric(?:al|ity)?|voltage|cable|(?:barb)?wire|power.?line", HAZARD,
           (((18, 7), (12, 17), (16, 17), (14, 25), (20, 14), (16, 14), (18, 7)),)),
    Symbol(r"(?:flood|under)?water(?:fall)?(?!.?(?:proof|bottle))|flood(?:ed|ing)?|river|pool", HAZARD,
           (_WAVES, tuple((x, y + 5) for x, y in _WAVES))),
    Symbol(r"(?:man|pot|sink)?hole|pit|collapsed?|debris|rubble|obstacle", HAZARD,
           (((8, 20), (12, 14), (15, 18), (18, 12), (24, 20)), ((8, 20), (24, 20)))),
    Symbol(r"(?:bio)?hazard(?:ous)?|danger(?:ous)?|warning|explo(?:sive|sion)|bomb|weapon|(?:hand)?gun|"
           r"(?:medical|clinical|hospital|infectious|nuclear).?waste", HAZARD, _BANG),
    Symbol(r"first.?aid|medic(?:al|ine)?|ambulance|hospital|defibrillator|aed", HELP,
           (((14, 9), (18, 9), (18, 14), (23, 14), (23, 18), (18, 18), (18, 23), (14, 23), (14, 18), (9, 18),
             (9, 14), (14, 14), (14, 9)),)),
    Symbol(r"robot|drone|uav|ugv|rover", HELP,
           (((10, 12), (22, 12), (22, 21), (10, 21), (10, 12)), ((16, 12), (16, 9)),
            _arc(13, 16, 1.2), _arc(19, 16, 1.2))),
    Symbol(r"shelter|tent|camp", HELP,
           (((7, 23), (16, 9), (25, 23), (7, 23)), ((16, 15), (13, 23)), ((16, 15), (19, 23)))),
    Symbol(r"exit|fire.?escape|(?:down|up)?stair(?:case|way|well)?|ladder", HELP,
           (((8, 22), (12, 22), (12, 18), (16, 18), (16, 14), (20, 14), (20, 10), (24, 10)),)),
    Symbol(r"(?:cell|smart|tele)?phone|radio|rope|helmet|drill|tool(?:box|kit)?|screw.?driver|"
           r"(?:flash|flood|head|search)?light|(?:head)?lamp", HELP,
           (((13, 8), (19, 8), (19, 24), (13, 24), (13, 8)), ((13, 20), (19, 20)), ((16, 22), (16, 22.2)))),
    Symbol(r"animal|dog|cat|cow|horse|bird|sheep", THING,
           (((9, 22), (9, 15), (20, 15), (23, 11), (23, 16), (20, 17), (20, 22)), ((9, 15), (7, 12)))),
    Symbol(r"car|vehicle|(?:fire)?truck|fire.?engine|bus(?:e)?|van|motor(?:bike|cycle|boat)?|bicycle|bike",
           THING,
           (((8, 20), (8, 16), (11, 15), (13, 11), (19, 11), (21, 15), (24, 16), (24, 20), (8, 20)),
            *_WHEELS)),
    Symbol(r"door(?:way)?|gate|window", THING, (((12, 25), (12, 8), (20, 8), (20, 25)), _arc(17.8, 17, 0.6))),
    Symbol(r"(?:green|ware)?house|building|fire.?station|(?:bath|bed|class)?room|wall", THING,
           (((7, 16), (16, 8), (25, 16)), ((9.5, 15), (9.5, 24), (22.5, 24), (22.5, 15)))),
    Symbol(r"tree|plant|bush(?:e)?", THING, (((16, 25), (16, 20)), ((16, 7), (22, 20), (10, 20), (16, 7)))),
    Symbol(r"[a-z]*box(?:e)?|backpack|[a-z]*bag|crate|suitcase|package", THING,
           (((9, 11), (23, 11), (23, 23), (9, 23), (9, 11)), ((9, 15), (23, 15)), ((16, 11), (16, 15)))),
    Symbol(r"sign|marker|(?:april)?tag|landmark|waypoint", THING,
           (((11, 25), (11, 8), (22, 11.5), (11, 15)),)),
)  # fmt: skip
"""The first one that matches is used."""
