"""One table of fields: client, server and the API's schema accept the same."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.errors import InputError
from webapp.missions.core.trajectory.batch import parse
from webapp.robot.fields import FAR, RECORDS, Number, Text, record_schema
from webapp.robot.records import ObjectFields, PoseFields, parse_record, to_json

NUMBERS = st.one_of(
    st.floats(),
    st.integers(-(10**13), 10**13),
    st.sampled_from([0, -90, 90, 90.5, -180, 180, FAR, -FAR, 2 * FAR, 10**9, 10**9 + 1, -1e-300, True, None]),
)
TEXTS = st.one_of(
    st.text(max_size=3), st.sampled_from(["x" * 200, "x" * 201, "gps", "0" * 64, "a\nb", "\ud800"])
)
TRACKS = st.fixed_dictionaries(
    {}, optional={"source": TEXTS, "track": TEXTS, "skipped": NUMBERS, "travelled_m": NUMBERS}
)
ANYTHING = st.one_of(NUMBERS, TEXTS, st.lists(NUMBERS, max_size=4), st.lists(TRACKS, max_size=2))
PLACE = {"type": "pose", "time": 1.0, "lat": 50.0, "lon": 14.0}
BASES = {
    "pose": PLACE,
    "object": PLACE | {"type": "object", "id": "a", "class": "b"},
    "status": {"type": "status", "time": 1.0, "text": "ready"},
    "end": {"type": "end"},
}


@given(st.data())
def test_what_the_client_takes_the_server_takes(data):
    type_ = data.draw(st.sampled_from(sorted(RECORDS)))
    names = data.draw(st.lists(st.sampled_from(sorted(RECORDS[type_])), max_size=4))
    try:
        record = parse_record(BASES[type_] | {name: data.draw(ANYTHING) for name in names}, now_s=0)
    except InputError as refusal:
        assert refusal.where
        return
    sent = json.loads(to_json(record))
    batch = parse([sent])
    assert (len(batch.sightings), batch.ends) == (type_ == "object", type_ == "end")
    assert parse_record(sent, now_s=0) == record


@pytest.mark.parametrize("type_", sorted(RECORDS))
def test_the_schema_has_the_fields_and_their_limits(type_):
    (schema,) = [s for s in record_schema()["oneOf"] if s["properties"]["type"] == {"const": type_}]
    fields = RECORDS[type_]
    assert schema["properties"].keys() == {"type", *fields} and not schema["additionalProperties"]
    assert set(schema["required"]) == {"type", *(name for name, field in fields.items() if field.required)}
    for name, field in fields.items():
        found = schema["properties"][name]
        assert found["description"]
        if isinstance(field, Number):
            beyond = math.nextafter(found["maximum"], math.inf) if not field.whole else found["maximum"] + 1
            limits, wrong = (found["minimum"], found["maximum"]), beyond
        elif isinstance(field, Text):
            limits, wrong = (
                ("0" * found["minLength"], "0" * found["maxLength"]),
                "0" * (found["maxLength"] + 1),
            )
        else:
            continue
        for value in limits:
            parse([BASES[type_] | {name: value}])
        with pytest.raises(InputError) as refusal:
            parse([BASES[type_] | {name: wrong}])
        assert refusal.value.where == f"records.0.{name}"


def test_the_arguments_of_the_client_are_the_fields():
    place = {"time", "lat", "lon"}
    assert PoseFields.__annotations__.keys() == RECORDS["pose"].keys() - place
    assert ObjectFields.__annotations__.keys() == RECORDS["object"].keys() - place - {"id", "class"}
