"""Default styles of layers for QGIS (QML), from version 3.22."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from webapp.files.exchange.xml import quoted

_MM_PER_PX = 25.4 / 96.0
_ARROW = "if(\"heading_deg\" is null, 'circle', 'arrow')"


def arrows(colour: str, *, size_mm: float, label: str | None = None, picture: str | None = None) -> str:
    """Return a style of points: arrows by the field `heading_deg`, dots where it is null.

    Args:
        colour: `#rrggbb`.
        label: Field that labels the points.
        picture: Field with the path of a picture, relative to the project, which forms show.
    """
    bound = _bound("angle", '"heading_deg"') + _bound("name", _ARROW)
    symbol = _symbol("marker", _marker("arrow", colour, size_mm=size_mm, bound=bound))
    return _document(_single(symbol), label=label, picture=picture)


def dots(colour: str, *, label: str | None = None) -> str:
    """Return a style of points: dots of a colour."""
    return _document(_single(_symbol("marker", _marker("circle", colour, size_mm=3.0))), label=label)


def outlines(colour: str, *, label: str) -> str:
    """Return a style of polygons: only their outlines."""
    options = {"style": "no", "outline_color": _rgba(colour), "outline_width": "0.5"}
    return _document(_single(_symbol("fill", _layer("SimpleFill", options))), label=label)


class LineLook(NamedTuple):
    """How the lines with a value of a field look."""

    label: str
    colour: str  # `#rrggbb`
    width_px: float
    shown: bool


def lines(field: str, looks: Mapping[int, LineLook]) -> str:
    """Return a style of lines, by the values of a field of whole numbers."""
    symbols, categories = [], []
    for number, (value, look) in enumerate(looks.items()):
        width = f"{look.width_px * _MM_PER_PX:.2f}"
        layer = _layer("SimpleLine", {"line_color": _rgba(look.colour), "line_width": width})
        symbols.append(_symbol("line", layer, name=str(number)))
        about = f'value="{value}" label={quoted(look.label)} render="{str(look.shown).lower()}"'
        categories.append(f'<category {about} symbol="{number}" type="long"/>')
    renderer = (
        f'<renderer-v2 type="categorizedSymbol" attr={quoteattr(field)} symbollevels="0" enableorderby="0">'
        f"<categories>{''.join(categories)}</categories><symbols>{''.join(symbols)}</symbols></renderer-v2>"
    )
    return _document(renderer)


def _document(renderer: str, *, label: str | None = None, picture: str | None = None) -> str:
    parts = [renderer]
    if label is not None:
        text = f'<text-style fieldName={quoteattr(label)} fontSize="8" textColor="20,24,26,255">'
        buffer = '<text-buffer bufferDraw="1" bufferSize="0.8" bufferColor="255,255,255,255"/>'
        parts.append(
            f'<labeling type="simple"><settings calloutType="simple">{text}{buffer}</text-style>'
            '<placement placement="6" dist="1"/></settings></labeling>'
        )
    if picture is not None:
        # DocumentViewer 1: a picture; RelativeStorage 1: relative to the project
        options = "".join(
            f'<Option type="int" name="{name}" value="1"/>' for name in ("DocumentViewer", "RelativeStorage")
        )
        parts.append(
            f"<fieldConfiguration><field name={quoteattr(picture)}>"
            f'<editWidget type="ExternalResource"><config><Option type="Map">{options}</Option></config>'
            "</editWidget></field></fieldConfiguration>"
        )
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
        f'<qgis version="3.22.0" labelsEnabled="{int(label is not None)}"'
        f' styleCategories="Symbology|Labeling|Fields|Forms">{"".join(parts)}</qgis>\n'
    )


def _single(symbol: str) -> str:
    return (
        '<renderer-v2 type="singleSymbol" symbollevels="0" enableorderby="0">'
        f"<symbols>{symbol}</symbols></renderer-v2>"
    )


def _symbol(kind: str, layer: str, *, name: str = "0") -> str:
    return f'<symbol type="{kind}" name="{name}" alpha="1" clip_to_extent="1">{layer}</symbol>'


def _marker(shape: str, colour: str, *, size_mm: float, bound: str = "") -> str:
    options = {
        "name": shape,
        "color": _rgba(colour),
        "outline_color": "255,255,255,255",
        "outline_width": "0.2",
        "size": f"{size_mm:g}",
        "size_unit": "MM",
    }
    return _layer("SimpleMarker", options, bound=bound)


def _layer(kind: str, options: Mapping[str, str], *, bound: str = "") -> str:
    written = "".join(
        f'<Option type="QString" name="{name}" value={quoteattr(value)}/>' for name, value in options.items()
    )
    properties = (
        '<data_defined_properties><Option type="Map"><Option type="QString" name="name" value=""/>'
        f'<Option type="Map" name="properties">{bound}</Option>'
        '<Option type="QString" name="type" value="collection"/></Option></data_defined_properties>'
    )
    return (
        f'<layer class="{kind}" enabled="1" locked="0" pass="0"><Option type="Map">{written}</Option>'
        f"{properties if bound else ''}</layer>"
    )


def _bound(option: str, expression: str) -> str:
    """Bind an option of a layer to an expression (type 3)."""
    return (
        f'<Option type="Map" name="{option}"><Option type="bool" name="active" value="true"/>'
        f'<Option type="QString" name="expression" value={quoteattr(expression)}/>'
        '<Option type="int" name="type" value="3"/></Option>'
    )


def _rgba(colour: str) -> str:
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return f"{red},{green},{blue},255"
