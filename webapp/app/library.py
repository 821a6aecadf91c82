"""What a library keeps besides maps, for backups."""

from __future__ import annotations

from webapp.missions.tasks.backup_part import MissionPart
from webapp.tasks.operate.parts import LibraryPart

PARTS: tuple[LibraryPart, ...] = (MissionPart(),)
