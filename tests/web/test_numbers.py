"""Integers that are too large for a column are refused in the same way on every database."""

import re

import pytest
from marshmallow import fields, validate

LARGEST = 2**31 - 1
OF_NO_RECORD = {"x", "y", "z"}
"""Integers that are no ids of records: coordinates of a tile."""

SIZES = {"size_bytes", "width", "height"}
"""Fields with other limits than that of a column."""


def integers(schema):
    """Yield name and largest value of the integers of a schema, recursively."""
    for name, field in schema.fields.items():
        inner = field.inner if isinstance(field, fields.List) else field
        if isinstance(inner, fields.Nested):
            yield from integers(inner.schema)
        elif isinstance(inner, fields.Integer):
            limits = [one.max for one in inner.validators if isinstance(one, validate.Range)]
            yield name, min((most for most in limits if most is not None), default=None)


def requests(app):
    """Yield the schemas of all requests."""
    for view in app.view_functions.values():
        spec = getattr(view, "_spec", {})
        for schema in (spec.get("body"), *(one[0] for one in spec.get("args", ()))):
            made = schema() if isinstance(schema, type) else schema
            if hasattr(made, "fields"):
                yield made


def test_ids_in_addresses_have_a_limit(app):
    unlimited = {name for rule in app.url_map.iter_rules() for name in re.findall(r"<int:(\w+)>", rule.rule)}
    assert unlimited == OF_NO_RECORD


def test_numbers_in_requests_have_a_limit(app):
    found = {(type(schema).__name__, *one) for schema in requests(app) for one in integers(schema)}
    assert len(found) > 30
    free = {f"{kind}.{name}" for kind, name, most in found if most is None or most > LARGEST}
    assert {one for one in free if one.partition(".")[2] not in SIZES} == set()


ASKED = [
    ("/api/v1/jobs/{}", 404, 404),
    ("/api/v1/maps/park/queries/{}", 404, 404),
    ("/api/v1/maps/park/queries?before={}", 200, 422),
    ("/api/v1/maps/park/queries/answers.csv?first={}", 200, 422),
    ("/api/v1/maps/park/queries/answers.csv?last={}", 200, 422),
    ("/api/v1/maps/park/photos?after={}", 200, 422),
    ("/api/v1/maps/park/changes?since={}", 200, 422),
    ("/api/v1/missions?after=1.{}", 200, 422),
]


@pytest.mark.parametrize(("address", "largest", "beyond"), ASKED)
def test_what_no_column_can_hold_is_refused(client, park, address, largest, beyond):
    assert client.get(address.format(LARGEST)).status_code == largest
    assert client.get(address.format(LARGEST + 1)).status_code == beyond
    assert client.get(address.format(2**40)).status_code == beyond


def test_a_change_of_what_no_column_can_hold_is_refused(client, park):
    def sent(id):
        changes = [{"id": id, "x_px": 1.0, "y_px": 1.0}]
        return client.patch("/api/v1/maps/park/experiences", json={"changes": changes}).status_code

    assert [sent(LARGEST), sent(LARGEST + 1)] == [404, 422]
    assert client.patch(f"/api/v1/maps/park/experiences/{LARGEST + 1}", json={}).status_code == 404


@pytest.mark.parametrize(("language", "comma"), [("en", "."), ("cs", ",")])
def test_numbers_of_any_size_on_pages_have_three_digits(app, language, comma):
    """Babel's pattern `@##` shows 0.0999 as 0.01."""
    show = app.jinja_env.filters["significant"]
    with app.test_request_context(headers={"Accept-Language": language}):
        assert show(0.0999) == f"0{comma}0999"
        for power in range(-8, 9):
            for n in range(1, 1000, 37):
                value = (1.0 + n * 0.008999) * 10.0**power
                text = "".join(c for c in show(value) if c.isdigit() or c == comma).replace(comma, ".")
                assert abs(float(text) - value) <= 0.0051 * value, (value, show(value))
