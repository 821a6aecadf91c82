"""Long work on missions outside a request."""

KINDS = {
    "mission-delete": "webapp.missions.jobs.delete:run",
    "mission-fix": "webapp.missions.jobs.localize_photos:run",
    "mission-fuse": "webapp.missions.jobs.fuse:run",
    "mission-import": "webapp.missions.jobs.import_file:run",
    "mission-pieces": "webapp.missions.jobs.pieces:run",
}
"""Name of each kind to "module:function"."""
