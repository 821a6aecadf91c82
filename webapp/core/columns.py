"""Meaning of a table's columns: given by the user, or guessed from the words in its header.

Written as `time=stamp:ms, lat=Latitude, lon=Longitude, heading=yaw:rad`: a field, the column by its header or
by its number from 1, and a unit if it is neither in the header nor the default. A unit that is not known is
refused, never replaced by the default.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from webapp.errors import TrackError, UsageError

_DEG = math.degrees(1.0)
EXCEL_DAYS = 86400.0
"""Scale of a time in days since 1899-12-30, as in spreadsheets."""

DATE_ORDERS = {"ymd": 1.0, "dmy": 2.0, "mdy": 3.0}
"""Orders of year, month and day in a date: units of its column, and the scales that encode them."""


def _split(text: str) -> tuple[str, ...]:
    return tuple(text.split())


_LENGTH = {
    "m": 1.0, "mm": 1e-3, "cm": 1e-2, "dm": 0.1, "km": 1e3,
    "in": 0.0254, "ft": 0.3048, "yd": 0.9144, "mi": 1609.344, "nmi": 1852.0,
}  # fmt: skip
_AREA = {"m2": 1.0, "mm2": 1e-6, "cm2": 1e-4, "ft2": 0.3048**2}
_POSITION = {
    "deg": 1.0, "rad": _DEG, "mrad": 1e-3 * _DEG, "min": 1.0 / 60.0, "arcsec": 1.0 / 3600.0, "gon": 0.9,
    "e7": 1e-7, "e6": 1e-6,
}  # fmt: skip
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "excel": EXCEL_DAYS},
    "nanos": {"ns": 1e-9, "us": 1e-6, "ms": 1e-3},
    "date": {"": 0.0, **DATE_ORDERS},
    "week": {"1": 1.0},
    "tow": {"s": 1.0, "ms": 1e-3},
    "lat": _POSITION,
    "lon": _POSITION,
    "lat_ref": {"": 1.0},
    "lon_ref": {"": 1.0},
    "height": _LENGTH,
    "heading": {"deg": 1.0, "rad": _DEG, "mrad": 1e-3 * _DEG, "cdeg": 1e-2, "gon": 0.9},
    "yaw": {"rad": 1.0, "mrad": 1e-3, "deg": 1.0 / _DEG, "cdeg": 1e-2 / _DEG, "gon": 0.9 / _DEG},
    "x": _LENGTH,
    "y": _LENGTH,
    "z": _LENGTH,
    "qx": {"1": 1.0},
    "qy": {"1": 1.0},
    "qz": {"1": 1.0},
    "qw": {"1": 1.0},
    "valid": {"": 1.0},
    "var_e": _AREA,
    "var_n": _AREA,
    "cov_en": _AREA,
    "accuracy": _LENGTH,
    "confidence": {"1": 1.0, "%": 1e-2},
    "id": {"": 1.0},
    "class": {"": 1.0},
    "track": {"": 1.0},
    "source": {"": 1.0},
}
"""Fields and their permitted units, the default first; text fields have none. A time may also be in ISO 8601.
`heading` is clockwise from north, `yaw` counter-clockwise from x; `accuracy` is one standard deviation in
each direction. `lat_ref` and `lon_ref` contain N or S and E or W if the numbers have no sign; `qx` to `qw`
are the orientation of the body."""

NEEDED = {"time", "lat", "lon", "x", "y", "z", "qx", "qy", "qz", "qw"}
"""Fields without which a track is wrong: a table is refused if one has a unit that is not known."""

UNIT_WORDS: Mapping[str, str] = {
    word: unit
    for unit, words in {
        "s": "sec secs second seconds sekunde sekunden sekunda sekundy segundo segundos seconde secondes",
        "ms": "msec msecs milli millis millisec millisecs millisecond milliseconds millisekunde "
        "millisekunden milisekunda milisekundy milisegundo milisegundos milliseconde millisecondes",
        "us": "µs μs usec usecs micro micros microsec microsecond microseconds mikrosekunde mikrosekunden "
        "mikrosekunda mikrosekundy microsegundo microsegundos microseconde microsecondes",
        "ns": "nsec nsecs nano nanos nanosec nanosecond nanoseconds nanosekunde nanosekunden nanosekunda "
        "nanosekundy nanosegundo nanosegundos nanoseconde nanosecondes",
        "min": "mins minute minutes minuten minuta minuty minuto minutos arcmin arcminute arcminutes ' ′",
        "h": "hr hrs hour hours stunde stunden hodina hodiny hora horas heure heures",
        "arcsec": 'arcsecs arcsecond arcseconds " ″',
        "m": "metre metres meter meters mtr mtrs metr metry metro metros metres",
        "mm": "millimetre millimetres millimeter millimeters milimetr milimetry milimetro milimetros",
        "cm": "centimetre centimetres centimeter centimeters zentimeter centimetr centimetry centimetro",
        "dm": "decimetre decimetres decimeter decimeters",
        "km": "kms kilometre kilometres kilometer kilometers kilometr kilometry kilometro kilometros",
        "in": "inch inches zoll pouce pouces palec palce pulgada pulgadas",
        "ft": "foot feet fuss stopa stopy pie pies pied pieds",
        "yd": "yds yard yards",
        "mi": "mile miles statute_mile statute_miles",
        "nmi": "nautical_mile nautical_miles",
        "deg": "° º degs degree degrees decimal_degree decimal_degrees decimal_deg decdeg dd deg_decimal "
        "degree_decimal dezimalgrad stupen stupne grado grados degre degres",
        "rad": "rads radian radians radiant radiany radianes",
        "mrad": "mrads milliradian milliradians",
        "gon": "gons gradian gradians",
        "cdeg": "centidegree centidegrees deg*100",
        "e7": "1e7 1e-7 dege7 deg_e7 degreese7 1e-7deg 1e-7_deg deg*1e7 10^-7_deg",
        "e6": "1e6 1e-6 dege6 deg_e6 degreese6 1e-6deg 1e-6_deg deg*1e6 10^-6_deg",
        "m2": "m² m^2 sqm",
        "mm2": "mm² mm^2",
        "cm2": "cm² cm^2",
        "ft2": "ft² ft^2",
        "px": "pixel pixels",
        "%": "percent prozent procent",
    }.items()
    for word in words.split()
}
"""Spellings of units in headers, without accents."""

QUALIFIERS = set(
    _split(
        "utc gmt gps gpst local lokal time unix epoch posix iso iso8601 iso-8601 since start 1970 1970-01-01 "
        "wgs84 epsg:4326 msl amsl asl agl above mean sea level rel relative abs absolute ellipsoid "
        "ellipsoidal geoid orthometric hae true magnetic mag enu ned map odom world frame north east n e +n "
        "+e n/s e/w dms forward left up right down - 1"
    )
)
"""Words in brackets that are no units."""

LOCAL_WORDS = {"local", "lokal", "mistni", "locale"}
UTC_WORDS = {"utc", "gmt", "zulu"}

_QUATERNIONS = "q q_ quaternion_ quat_ orientation_ rotation_ rot_ q_rs_"

NAMES: dict[str, Sequence[str]] = {
    "time": _split(
        "time timestamp timestamps stamp t utc datetime date_time date_and_time unixtime unix_time epoch "
        "times utc_t utc_time time_utc gmt_time datetime_utc utc_datetime timestamp_utc gps_time gpst "
        "header_stamp_sec header_stamp_secs stamp_sec stamp_secs secs "
        "unix_timestamp timestamp_unix epoch_time time_epoch posix_time system_time ros_time header_stamp "
        "capture_time sample_time fix_time log_time recorded_at measured_at elapsed elapsed_time flight_time "
        "osd_flytime custom_updatetime "
        "local_time time_local datetime_local frame_id gpsdatetime zeit "
        "uhrzeit zeitpunkt zeitstempel datum_zeit datum/zeit datum_uhrzeit datum_und_uhrzeit cas "
        "datum_cas datum_a_cas casova_znacka casove_razitko tiempo hora fecha_hora fecha_y_hora "
        "marca_de_tiempo marca_temporal temps heure date_heure date_et_heure horodatage czas znacznik_czasu "
        "data_i_godzina ora data_ora"
    ),
    "date": _split("date utc_d utc_date date_utc gps_date local_date date_local custom_date datum fecha"),
    "nanos": _split(
        "nanos nanosec nanosecs nsec nsecs stamp_nsec stamp_nsecs stamp_nanosec header_stamp_nsec "
        "header_stamp_nsecs header_stamp_nanosec"
    ),
    "week": _split(
        "week weeks gps_week gpsweek gps_wk gwk gps_wn wn weekno week_no week_number gps_week_number wnum"
    ),
    "tow": _split(
        "tow gps_tow gpstow sow gps_sow itow i_tow gms time_of_week gps_time_of_week seconds_of_week "
        "second_of_week sec_of_week secs_of_week seconds_in_week seconds_into_week sec_in_week ms_of_week "
        "week_seconds week_second week_sec weeksec weekseconds week_time gps_seconds gps_second gps_secs "
        "gps_sec gpsseconds gpssecond gpssec gps_milliseconds gps_ms gps_week_seconds"
    ),
    "lat": _split(
        "lat latitude gps_lat gps_latitude gpslatitude latitude_n/s osd_latitude breite breitengrad "
        "geogr_breite geografische_breite geographische_breite nordliche_breite sirka zemepisna_sirka "
        "zem_sirka z_sirka sev_sirka severni_sirka latitud latitudine szerokosc szerokosc_geograficzna "
        "szer_geogr lat_wgs84 latitude_wgs84 x_lat y/latitude"
    ),
    "lon": _split(
        "lon lng long longitude gps_lon gps_lng gps_long gps_longitude gpslongitude longitude_e/w "
        "osd_longitude lange laenge langengrad laengengrad geogr_lange geogr_laenge geografische_lange "
        "geographische_lange geographische_laenge ostliche_lange delka zemepisna_delka zem_delka z_delka "
        "vych_delka vychodni_delka longitud longitudine dlugosc dlugosc_geograficzna dl_geogr lon_wgs84 "
        "lng_wgs84 longitude_wgs84 x/longitude"
    ),
    "lat_ref": _split("n/s ns n_s lat_ref latitude_ref gpslatituderef lat_dir"),
    "lon_ref": _split("e/w ew e_w lon_ref longitude_ref gpslongituderef lon_dir"),
    "height": _split(
        "height alt altitude ele elevation gps_altitude gpsaltitude altitude_above_sealevel "
        "altitude_above_sea_level altitude_msl osd_altitude hohe hoehe gps_hohe hohe_uber_nn "
        "hohe_uber_meer meereshohe vyska nadmorska_vyska altura altitud elevacion cota hauteur wysokosc "
        "wysokosc_npm altitudine quota"
    ),
    "heading": _split(
        "heading hdg course bearing azimuth cog compass_heading true_heading kurs fahrtrichtung peilung "
        "azimut smer kurz rumbo acimut cap"
    ),
    "yaw": _split("yaw theta"),
    "x": _split("x tx pos_x position_x translation_x p_x p_rs_r_x"),
    "y": _split("y ty pos_y position_y translation_y p_y p_rs_r_y"),
    "z": _split("z tz pos_z position_z translation_z p_z p_rs_r_z"),
    **{f"q{axis}": tuple(f"{name}{axis}" for name in _split(_QUATERNIONS)) for axis in "xyzw"},
    "valid": _split("valid fix_mode fix fix_type gultig platny valido valide"),
    "var_e": _split("var_e"),
    "var_n": _split("var_n"),
    "cov_en": _split("cov_en"),
    "accuracy": _split("accuracy hacc horizontal_accuracy genauigkeit presnost precision exactitud"),
    "confidence": _split("confidence score konfidenz confianza confiance"),
    "id": _split("id object_id object objekt objeto objet"),
    "class": _split("class kind type label klasse typ trida druh clase tipo classe"),
    "track": _split("track spur trasa traza trace"),
    "source": _split("source"),
}
"""Headers by which each field is recognised: lower case, without accents, words joined by `_`."""

PHOTO_UNITS: dict[str, dict[str, float]] = {
    "name": {"": 1.0},
    "lat": UNITS["lat"],
    "lon": UNITS["lon"],
    "lat_ref": {"": 1.0},
    "lon_ref": {"": 1.0},
    "x": {"px": 1.0},
    "y": {"px": 1.0},
    "heading": UNITS["heading"],
}
"""`lat_ref` and `lon_ref` contain N or S and E or W if the numbers have no sign."""

PHOTO_NAMES: dict[str, Sequence[str]] = {
    "name": _split(
        "name photo photo_name file filename file_name sourcefile source_file path image image_name img "
        "picture title bild bildname foto fotoname datei dateiname fotka fotografie snimek obrazek soubor "
        "nazev jmeno nazev_souboru jmeno_souboru fotografia imagen archivo nombre nombre_de_archivo "
        "fichier nom nom_de_fichier nom_du_fichier photographie imagename photoname image_filename label "
        "fichero photoid photo_id bilddatei fotodatei name_des_bildes nazev_snimku nazev_fotky "
        "nazev_fotografie nazev_obrazku jmeno_fotky jmeno_snimku nombre_de_la_foto nombre_de_la_imagen "
        "nombre_de_imagen nombre_de_foto nom_de_la_photo nom_de_l'image nom_image nom_photo zdjecie plik "
        "nazwa nazwa_pliku immagine nome nome_file"
    ),
    "lat": NAMES["lat"],
    "lon": NAMES["lon"],
    "lat_ref": _split("lat_ref gpslatituderef"),
    "lon_ref": _split("lon_ref gpslongituderef"),
    "x": _split("x px pixel_x column x/easting x/east easting geo_x"),
    "y": _split("y py pixel_y row y/northing y/north northing geo_y"),
    "heading": (
        *NAMES["heading"],
        *_split(
            "yaw direction richtung blickrichtung ausrichtung natoceni direccion orientacion orientation "
            "gpsimgdirection"
        ),
    ),
}


@dataclass(frozen=True, slots=True)
class ColumnFields:
    units: Mapping[str, Mapping[str, float]]  # The units of each field
    # Headers by which each field is recognised: lower case, words joined by `_`.
    names: Mapping[str, Sequence[str]]
    needed: tuple[str, ...]  # Fields that are required in addition to a position
    example: str  # Example of how columns are written
    by_name: Mapping[str, str] = field(init=False, repr=False)  # The field of each header

    def __post_init__(self) -> None:
        known = ((word, name) for name, words in reversed(list(self.names.items())) for word in words)
        object.__setattr__(self, "by_name", dict(known))


POSE_FIELDS = ColumnFields(UNITS, NAMES, (), "time=stamp:ms, lat=Latitude, lon=Longitude")
"""Poses and objects of a mission."""

PHOTO_FIELDS = ColumnFields(PHOTO_UNITS, PHOTO_NAMES, ("name",), "name=File, lat=Latitude, lon=Longitude")
"""Positions of photos, on the Earth or in pixels of the satellite image."""

_PART = re.compile(r"\s*([a-z_]+)\s*=\s*(.+?)\s*(?::\s*([a-z0-9%]+)\s*)?", re.IGNORECASE)
_IN_BRACKETS = re.compile(r"(.+?)[\s_]*[\[({]([^\[\](){}]*)[\])}]\s*")
_AFTER_SLASH = re.compile(r"(.+?)\s*/\s*([^/]+)")
_AFTER_WORD = re.compile(
    r"(.+?)[_\s](s|sec|seconds|ms|msec|millis|milliseconds|us|usec|micros|microseconds|ns|nsec|nanos|nanoseconds|"
    r"m|m2|mm|cm|km|ft|feet|yd|metres|meters|deg|degrees|rad|radians|mrad|e7|e6|px)"
)
"""A unit after a name; those that are words themselves (`min`, `in`) only count in brackets."""

_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")

LONGEST_HEADER = 100
"""Characters; a longer cell is no header, and taking it apart could take quadratic time."""


@dataclass(frozen=True, slots=True)
class Column:
    index: int  # From 0
    scale: float  # Factor that converts its numbers to the field's default unit


Columns = Mapping[str, Column]


def parse_columns(text: str, header: Sequence[str], *, fields: ColumnFields = POSE_FIELDS) -> Columns:
    """Parse the user's assignment of columns to fields.

    Args:
        text: Fields separated by commas, as described above.
        header: The table's first line; names are compared without regard to case.
        fields: Fields that the table can have.
    """
    names = [name.strip().lstrip("#%").strip().lower() for name in header]
    found: dict[str, Column] = {}
    for part in text.split(","):
        written = _PART.fullmatch(part)
        field = written[1].lower() if written else ""
        if written is None or field not in fields.units:
            hint = f"write it like {fields.example}; fields are {', '.join(fields.units)}"
            raise UsageError(
                f"{part.strip()[:60]!r} is not a field of this table", where="columns", hint=hint
            )
        name, unit = written[2], written[3]
        index = _place(name, names)
        if index is None and unit is not None:  # the header itself contains the colon
            index, unit = _place(f"{name}:{unit}", names), None
        if index is None:
            hint = f"its columns are {', '.join(header)[:200]}; numbers count from 1"
            raise UsageError(f"the table has no column {name[:40]!r}", where="columns", hint=hint)
        units = fields.units[field]
        unit = _stated(header[index], units) if unit is None else unit
        found[field] = Column(index, _scale(field, unit, units=units))
    problem = _missing(found, fields)
    if 0 < sum(f"q{axis}" in found for axis in "xyzw") < len("xyzw"):
        problem = "the quaternion is incomplete"
    if ("week" in found) != ("tow" in found):
        problem = "a time of GPS needs both week and tow, the seconds of the week"
    if problem:
        raise UsageError(problem, where="columns", hint=f"write them like {fields.example}")
    return found


class Header(NamedTuple):
    field: str | None  # None if it is not recognised
    unit: str | None  # As written; None without one
    basis: int  # Of a time: 1 for UTC, -1 for a local time, 0 if it does not say


def read_header(name: str, *, fields: ColumnFields = POSE_FIELDS) -> Header:
    """Recognise a field and a unit: `timestamp_ms`, `Latitude [deg]`, `Höhe (m)`, `timeNanos` ..."""
    found = _read_plain(_header(name), fields)
    return found if found.field else _read_plain(_header(_CAMEL.sub("_", name)), fields)


def _read_plain(plain: str, fields: ColumnFields) -> Header:
    plain = plain.removeprefix("field.")  # as `rostopic echo -p` writes
    words = set(re.findall(r"[a-z]+", plain))
    basis = 1 if words & UTC_WORDS else -1 if words & LOCAL_WORDS else 0
    whole = _recognized(plain, fields)
    if whole is not None:
        return Header(whole, None, basis)
    for pattern in (_IN_BRACKETS, _AFTER_SLASH, _AFTER_WORD):
        parts = pattern.fullmatch(plain)
        if parts is None:
            continue
        unit = parts[2].strip() if _spelled(parts[2]) else None
        field = _recognized(parts[1], fields)
        if field is None and pattern is _IN_BRACKETS:  # `time_utc (ms)` or `timestamp_ms (UTC)`
            inner = _read_plain(parts[1], fields)
            field, unit = inner.field, unit or inner.unit
        if field is not None:
            return Header(field, unit, basis)
    return Header(None, None, basis)


def is_header(cell: str) -> bool:
    """Return whether a cell is a known header of some table."""
    return any(read_header(cell, fields=fields).field for fields in (POSE_FIELDS, PHOTO_FIELDS))


def guess_columns(
    header: Sequence[str], *, fields: ColumnFields = POSE_FIELDS, remarks: list[str] | None = None
) -> Columns:
    """Guess the columns' fields from the header; of several of a field the first is taken.

    Args:
        remarks: Gets a sentence on each column that is left out because its unit is not known.

    Raises:
        TrackError: No columns for a position or another required field are recognised, or a time or a
            position has an unknown unit.
    """
    found: dict[str, Column] = {}
    unknown: dict[str, tuple[str, str]] = {}
    for index, name in enumerate(header):
        field, unit, _ = read_header(name, fields=fields)
        if field is None or field in found:
            continue
        units = fields.units[field]
        scale = _known_scale(unit, units)
        if scale is None:
            unknown.setdefault(field, (name.strip(), str(unit)))
        else:
            found[field] = Column(index, scale)
    for pair in (("lat", "lon"), ("x", "y")):
        if len(found.keys() & {"lat", "lon", "x", "y"}) == 3 and len(found.keys() & set(pair)) == 1:
            found = {field: column for field, column in found.items() if field not in pair}
    for field, (name, unit) in unknown.items():
        if field in found:
            continue
        if field in NEEDED:
            raise TrackError(
                f"the unit {unit[:40]!r} of the column {name[:60]!r} is not known",
                hint=f"convert it, or give the columns with one of {', '.join(fields.units[field])}",
            )
        if remarks is not None:
            remarks.append(f"the column {name[:60]!r} is left out, as its unit {unit[:40]!r} is not known")
    if _missing(found, fields):
        hint = f"assign columns to fields, such as {fields.example}"
        what = " and ".join((*(f"{field}s" for field in fields.needed), "positions"))
        raise TrackError(f"no columns of {what} are recognised in {', '.join(header)[:100]!r}", hint=hint)
    return found


def candidates(header: Sequence[str], field: str) -> list[tuple[Column, int]]:
    """Return every column of a field whose unit is known, each with its basis (see `Header`)."""
    read = [read_header(name) for name in header]
    scales = [
        _known_scale(one.unit, POSE_FIELDS.units[field]) if one.field == field else None for one in read
    ]
    return [(Column(n, s), read[n].basis) for n, s in enumerate(scales) if s is not None]


def unit_word(text: str) -> str:
    """Return the name of a unit that may be spelled out: `ms` for `milliseconds`."""
    word = _spelled(text)
    return UNIT_WORDS.get(word, word)


def _spelled(text: str) -> str:
    """Join the words of a unit, without those that are no part of it: `m` of `m above sea level`."""
    words = re.split(r"[\s,;_]+|(?<=[a-z])-(?=[a-z])", text.strip().rstrip("."))
    return "_".join(word for word in words if word and word not in QUALIFIERS)


def _plain(text: str) -> str:
    """Return a header in lower case without accents and marks of comments."""
    parts = unicodedata.normalize("NFKD", text.strip().lstrip("#%").strip().lower().replace("º", "°"))
    plain = "".join(one for one in parts if not unicodedata.combining(one))
    return plain.replace("ß", "ss").replace("ł", "l")


def _header(cell: str) -> str:
    """Return a cell as `_plain` does; empty if it is too long for a header."""
    plain = _plain(cell) if len(cell.strip()) <= LONGEST_HEADER else ""
    return plain if len(plain) <= LONGEST_HEADER else ""


def _words(text: str) -> str:
    return re.sub(r"[\s._\-]+", "_", text.strip()).strip("_")


def _recognized(name: str, fields: ColumnFields) -> str | None:
    return fields.by_name.get(_words(name))


def _known_scale(unit: str | None, units: Mapping[str, float]) -> float | None:
    """Return the scale of a unit; the default's without one, and for texts. None if it is not known."""
    if unit is None or not any(units):
        return next(iter(units.values()))
    return units.get(unit_word(unit))


def _stated(name: str, units: Mapping[str, float]) -> str | None:
    plain = _header(name)
    in_brackets, after = _IN_BRACKETS.fullmatch(plain), _AFTER_WORD.fullmatch(plain)
    if in_brackets is not None and _spelled(in_brackets[2]) and any(units):
        return in_brackets[2].strip()
    return after[2] if after is not None and unit_word(after[2]) in units else None


def _place(name: str, names: Sequence[str]) -> int | None:
    wanted = name.strip().strip("'\"").lower()
    if wanted in names:
        return names.index(wanted)
    if wanted.isascii() and wanted.isdecimal() and 1 <= int(wanted) <= len(names):
        return int(wanted) - 1
    return None


def _scale(field: str, unit: str | None, *, units: Mapping[str, float]) -> float:
    scale = next(iter(units.values())) if unit is None else units.get(unit_word(_plain(unit)))
    if scale is None:
        raise UsageError(
            f"{field} has no unit {unit!r}",
            where="columns",
            hint=f"permitted units: {', '.join(filter(None, units)) or 'none'}",
        )
    return scale


def _missing(found: Columns, fields: ColumnFields) -> str | None:
    needed = next((field for field in fields.needed if field not in found), None)
    if needed is not None:
        return f"no column holds a {needed}"
    if ("lat" in found) != ("lon" in found) or ("x" in found) != ("y" in found):
        return "only one of the two coordinates has a column"
    return None if "lat" in found or "x" in found else "no column holds a position"
