"""Checks the structure of a KML document against the schemas of the OGC and the rules of KML 2.3.

Order, number and nesting of elements are read from the XML schemas of KML 2.2 and of Google's extension that
fastkml includes: KML 2.3 adopted `gx:Track` and `gx:MultiTrack` unchanged. Other rules come from the abstract
test suite of KML 2.3 (OGC 14-068), by number.
"""

import warnings
from datetime import datetime
from functools import cache
from importlib.resources import files
from itertools import pairwise
from xml.etree import ElementTree as ET

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # fastkml recommends lxml for prettier output
    import fastkml

XS = "{http://www.w3.org/2001/XMLSchema}"
KML = "{http://www.opengis.net/kml/2.2}"
GX = "{http://www.google.com/kml/ext/2.2}"
_FILES = {KML: "ogckml22.xsd", GX: "kml22gx.xsd"}
_PREFIX = {"kml": KML, "gx": GX}


@cache
def _schemas():
    """Return types, elements, and the substitutes of abstract elements."""
    types, elements, stands_for = {}, {}, {}
    for namespace, name in _FILES.items():
        for node in ET.fromstring(files(fastkml).joinpath("schema", name).read_text("utf-8")):
            if node.tag in (XS + "complexType", XS + "group"):
                types[namespace + node.get("name")] = node
            if node.tag == XS + "element":
                elements[namespace + node.get("name")] = node
                if node.get("substitutionGroup"):
                    head = _named(node.get("substitutionGroup"))
                    stands_for.setdefault(head, set()).add(namespace + node.get("name"))
    return types, elements, stands_for


def _named(name):
    prefix, _, local = name.rpartition(":")
    return _PREFIX.get(prefix, "{other}") + local


def _all_for(name):
    """Return all elements that can substitute `name`."""
    found = {name}
    for other in _schemas()[2].get(name, ()):
        found |= _all_for(other)
    return found


def _particles(kind):
    """Return the content of a type, in order: sets of elements, their numbers, and types of local ones."""
    node = _schemas()[0].get(kind)
    extension = None if node is None else node.find(f".//{XS}extension")
    base = []
    if extension is not None:
        base = _particles(_named(extension.get("base")))
        node = extension
    return base + ([] if node is None else _inner(node))


def _inner(node):
    found = []
    for child in node:
        most = {"unbounded": 10**9}.get(child.get("maxOccurs"), int(child.get("maxOccurs", 1) != "0"))
        least = int(child.get("minOccurs", 1))
        if child.tag == XS + "element":
            name = _named(child.get("ref")) if child.get("ref") else KML + child.get("name")
            local = _named(child.get("type")) if child.get("type") else None
            found.append((_all_for(name), least, most, local))
        elif child.tag == XS + "choice":
            options = [names for names, *_ in _inner(child)]
            found.append((set().union(*options), 0, most, None))
        elif child.tag in (XS + "sequence", XS + "all"):
            found += _inner(child)
    return found


def check_structure(element, kind=None):
    """Assert that an element and its descendants have the content and order of their types."""
    node = _schemas()[1].get(element.tag)
    kind = kind or (node is not None and node.get("type") and _named(node.get("type")))
    assert kind, f"no schema knows {element.tag}"
    particles = _particles(kind)
    place, count = 0, 0
    for child in element:
        while place < len(particles) and child.tag not in particles[place][0]:
            assert count >= particles[place][1], f"{element.tag} lacks {particles[place][0]}"
            place, count = place + 1, 0
        assert place < len(particles), f"{child.tag} is out of place in {element.tag}"
        count += 1
        assert count <= particles[place][2], f"too many {child.tag} in {element.tag}"
        check_structure(child, particles[place][3])


def check_kml(data):
    """Assert that a document is KML, and return its root."""
    root = ET.fromstring(data)
    assert root.tag == KML + "kml"
    check_structure(root)
    for track in root.iter(GX + "Track"):
        _check_track(track)
    for coordinates in root.iter(KML + "coordinates"):
        for position in coordinates.text.split():
            _check_position([float(part) for part in position.split(",")])
    for span in root.iter(KML + "TimeSpan"):
        begin, end = (_time(span.find(KML + name)) for name in ("begin", "end"))
        assert begin <= end, "ATC-115: a time span begins before it ends"
    ids = [e.get("id") for e in root.iter() if e.get("id")]
    assert len(ids) == len(set(ids)), "ids are unique"
    for url in root.iter(KML + "styleUrl"):
        assert url.text.removeprefix("#") in ids, "ATC-6: a style that is named is there"
    return root


def _check_track(track):
    whens = [_time(when) for when in track.iter(KML + "when")]
    coords = [coord.text.split() for coord in track.iter(GX + "coord")]
    angles = [angle.text.split() for angle in track.iter(GX + "angles")]
    assert coords, "ATC-146: a track has positions"
    assert len(whens) == len(coords), "ATC-147: as many times as positions"
    assert len(angles) in (0, len(whens)), "ATC-147: as many angles as positions, or none"
    assert all(len(angle) == 1 and 0 <= float(angle[0]) <= 360 for angle in angles), "ATC-148: heading alone"
    assert all(a < b for a, b in pairwise(whens)), "times ascend"
    for coord in coords:
        assert len(coord) == 3, "ATC-146: longitude, latitude, height"
        _check_position([float(part) for part in coord])


def _check_position(position):
    lon, lat, *_ = position
    assert len(position) in (2, 3) and -180 <= lon <= 180 and -90 <= lat <= 90


def _time(element):
    time = datetime.fromisoformat(element.text)
    assert time.tzinfo is not None
    return time
