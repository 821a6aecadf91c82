"""Words in the headers of tables: units of numbers, and names of columns in the program's languages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

_DEG = math.degrees(1.0)
EXCEL_DAYS = 86400.0
"""Scale of a time in days since 1899-12-30, as in spreadsheets."""

DATE_ORDERS = {"ymd": 1.0, "dmy": 2.0, "mdy": 3.0}
"""Orders of year, month and day in a date: units of its column, and the scales that encode them."""


def _words(text: str) -> tuple[str, ...]:
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
    _words(
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
    "time": _words(
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
    "date": _words("date utc_d utc_date date_utc gps_date local_date date_local custom_date datum fecha"),
    "nanos": _words(
        "nanos nanosec nanosecs nsec nsecs stamp_nsec stamp_nsecs stamp_nanosec header_stamp_nsec "
        "header_stamp_nsecs header_stamp_nanosec"
    ),
    "week": _words(
        "week weeks gps_week gpsweek gps_wk gwk gps_wn wn weekno week_no week_number gps_week_number wnum"
    ),
    "tow": _words(
        "tow gps_tow gpstow sow gps_sow itow i_tow gms time_of_week gps_time_of_week seconds_of_week "
        "second_of_week sec_of_week secs_of_week seconds_in_week seconds_into_week sec_in_week ms_of_week "
        "week_seconds week_second week_sec weeksec weekseconds week_time gps_seconds gps_second gps_secs "
        "gps_sec gpsseconds gpssecond gpssec gps_milliseconds gps_ms gps_week_seconds"
    ),
    "lat": _words(
        "lat latitude gps_lat gps_latitude gpslatitude latitude_n/s osd_latitude breite breitengrad "
        "geogr_breite geografische_breite geographische_breite nordliche_breite sirka zemepisna_sirka "
        "zem_sirka z_sirka sev_sirka severni_sirka latitud latitudine szerokosc szerokosc_geograficzna "
        "szer_geogr lat_wgs84 latitude_wgs84 x_lat y/latitude"
    ),
    "lon": _words(
        "lon lng long longitude gps_lon gps_lng gps_long gps_longitude gpslongitude longitude_e/w "
        "osd_longitude lange laenge langengrad laengengrad geogr_lange geogr_laenge geografische_lange "
        "geographische_lange geographische_laenge ostliche_lange delka zemepisna_delka zem_delka z_delka "
        "vych_delka vychodni_delka longitud longitudine dlugosc dlugosc_geograficzna dl_geogr lon_wgs84 "
        "lng_wgs84 longitude_wgs84 x/longitude"
    ),
    "lat_ref": _words("n/s ns n_s lat_ref latitude_ref gpslatituderef lat_dir"),
    "lon_ref": _words("e/w ew e_w lon_ref longitude_ref gpslongituderef lon_dir"),
    "height": _words(
        "height alt altitude ele elevation gps_altitude gpsaltitude altitude_above_sealevel "
        "altitude_above_sea_level altitude_msl osd_altitude hohe hoehe gps_hohe hohe_uber_nn "
        "hohe_uber_meer meereshohe vyska nadmorska_vyska altura altitud elevacion cota hauteur wysokosc "
        "wysokosc_npm altitudine quota"
    ),
    "heading": _words(
        "heading hdg course bearing azimuth cog compass_heading true_heading kurs fahrtrichtung peilung "
        "azimut smer kurz rumbo acimut cap"
    ),
    "yaw": _words("yaw theta"),
    "x": _words("x tx pos_x position_x translation_x p_x p_rs_r_x"),
    "y": _words("y ty pos_y position_y translation_y p_y p_rs_r_y"),
    "z": _words("z tz pos_z position_z translation_z p_z p_rs_r_z"),
    **{f"q{axis}": tuple(f"{name}{axis}" for name in _words(_QUATERNIONS)) for axis in "xyzw"},
    "valid": _words("valid fix_mode fix fix_type gultig platny valido valide"),
    "var_e": _words("var_e"),
    "var_n": _words("var_n"),
    "cov_en": _words("cov_en"),
    "accuracy": _words("accuracy hacc horizontal_accuracy genauigkeit presnost precision exactitud"),
    "confidence": _words("confidence score konfidenz confianza confiance"),
    "id": _words("id object_id object objekt objeto objet"),
    "class": _words("class kind type label klasse typ trida druh clase tipo classe"),
    "track": _words("track spur trasa traza trace"),
    "source": _words("source"),
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
    "name": _words(
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
    "lat_ref": _words("lat_ref gpslatituderef"),
    "lon_ref": _words("lon_ref gpslongituderef"),
    "x": _words("x px pixel_x column x/easting x/east easting geo_x"),
    "y": _words("y py pixel_y row y/northing y/north northing geo_y"),
    "heading": (
        *NAMES["heading"],
        *_words(
            "yaw direction richtung blickrichtung ausrichtung natoceni direccion orientacion orientation "
            "gpsimgdirection"
        ),
    ),
}
