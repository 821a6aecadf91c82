"""QR codes as SVG paths."""

from __future__ import annotations

from typing import Any

from reportlab.graphics.barcode.qrencoder import QRCode, QRErrorCorrectLevel

_QUIET = 4
"""Modules of white around a code, by its standard (ISO/IEC 18004)."""


def qr_path(text: str) -> dict[str, Any]:
    """Encode a text: `size`, the side with the quiet zone in modules, and `path`, the `d` of an SVG path."""
    code = QRCode(None, QRErrorCorrectLevel.M)
    code.addData(text)
    code.make()
    dark = [
        f"M{x + _QUIET} {y + _QUIET}h1v1h-1z"
        for y, row in enumerate(code.modules)
        for x, module in enumerate(row)
        if module
    ]
    return {"size": code.getModuleCount() + 2 * _QUIET, "path": "".join(dark)}
