"""GIS: maps and missions in QGIS, QField and ArcGIS, as GeoPackage and by OGC API - Features."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.gis.command:gis",
    "Write a map or a mission as a GeoPackage for QGIS and QField.",
    "webapp.connect.gis.web:PARTS",
)
