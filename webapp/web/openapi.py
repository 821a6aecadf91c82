"""The OpenAPI document: what APIFlask finds in the routes, completed by what all of them have in common."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from functools import partial
from http import HTTPStatus
from typing import Any, cast

from apiflask import APIFlask, Schema
from apispec import APISpec
from apispec.ext.marshmallow.common import make_schema_key, resolve_schema_instance
from flask import Flask
from werkzeug.routing import Rule

from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.render.export_file import FORMATS
from webapp.render.sheet.options import SHEET_FORMATS
from webapp.web import chunks
from webapp.web.context import is_public
from webapp.web.state import parts

PATH = "/api/v1/openapi.json"

_ABOUT = """\
Maps of places where photos were taken, and answers to "where was this photo taken?".

Everything that the pages do goes through these addresses. Programs send a token with each request:
`Authorization: Bearer TOKEN`; the account page makes one, and so does `expmap account token --name NAME`.

Positions are pixels of the map's image: x to the right, y down, (0, 0) is the outer corner of its top-left
pixel. Angles are degrees clockwise from north. Times are ISO 8601.

Each error has one shape, whatever its status: `{"error": {"code", "message", "hint", "where"}}`.
"""

_TAGS = {
    "Maps": "Maps, the places of their photos, and undo.",
    "Satellite image": "The image of a map, and where it is on the Earth.",
    "Floors": "Several images of a map, one above the other.",
    "Photos": "Photos of a map, several in one request.",
    "Uploads": "Photos sent in chunks, which can be resumed.",
    "Placing": "Many photos placed at once.",
    "Landmarks": "Points that several photos show, with the cameras that see them, on the map.",
    "Placements": "Further sets of places for the photos of a map.",
    "Localization": "Where was this photo taken? And what was asked before.",
    "Session": "Who is signed in.",
    "Accounts": "One's own account and tokens, and, for the owner of the library, all accounts.",
    "Sharing": "Links that show a map, an answer or a mission without a sign-in.",
    "Shared": "What such a link shows: for visitors, without a sign-in.",
    "Checks": "What is wrong with a map, and which of its places are weak.",
    "Import and export": "Maps on their way in and out.",
    "Missions": "Where robots and people were, and what they saw there.",
    "Jobs": "Long work outside a request.",
}

_PARAMETERS: dict[str, dict[str, Any]] = {
    "key": {"description": "As the description of the landmarks has it."},
    "number": {"description": "Which part, from 0."},
    "slug": {"description": "The map: the last part of its address."},
    "id": {"description": "Id, unique in the map."},
    "token": {"description": "The end of the address of what is shared."},
    "sha256": {"description": "SHA-256 of the photo, hexadecimal."},
    "job_id": {"description": "Id of the job."},
    "token_id": {"description": "Id of the token."},
    "account_id": {"description": "Id of the account."},
    "name": {"description": "Name, as it is listed."},
    "form": {"description": "Format.", "schema": {"type": "string", "enum": list(FORMATS)}},
    "sheet": {"description": "Format.", "schema": {"type": "string", "enum": list(SHEET_FORMATS)}},
    "z": {"description": "Zoom level: 0 shows the image in one tile."},
    "x": {"description": "Column of the tile, from the left."},
    "y": {"description": "Row of the tile, from the top."},
}

_LIMITS = {"max": ("maximum",), "maxlength": ("maxLength",), "length": ("minLength", "maxLength")}

_ALWAYS = (401, 429, 503)
_OF_PATH = (404, 405)
_OF_INPUT = (400, 422)
_OF_BODY = (413, 415)
_OF_CHANGE = (400, 403, 404, 409, 422, 507)
_OF_REVISION = (412,)
_MEANINGS = {
    400: "The request cannot work as it was sent.",
    401: "Nobody is signed in, or the token is not known.",
    403: "Who asks may see it, but not do this.",
    404: "It does not exist, or is not shared with the caller.",
    405: "This cannot be done at this address.",
    409: "Somebody else has changed it in the meantime, or it is not ready yet.",
    412: "Somebody else has changed it since the revision in `If-Match`.",
    413: "The request is too large.",
    415: "The request is of the wrong type.",
    422: "A field or a file cannot be used, or a part that it needs is not installed on the server.",
    429: "Too many requests in a short time; `Retry-After` says how many seconds to wait.",
    503: "The server is busy (`Retry-After` says how many seconds to wait), or an index is being repaired.",
    507: "There is no space left on the server's disk; nothing was kept.",
}


_IF_MATCH = {
    "name": "If-Match",
    "in": "header",
    "description": "Newest revision that you know: what was changed later is answered by 412.",
    "schema": {"type": "string", "pattern": '^("[0-9]{1,15}"|[0-9]{1,15})$'},
}
_MORE: dict[str, dict[str, Any]] = {
    "api_blur.list_suggestions": {"statuses": [400, 403, 422]},
    "api_blur.suggest": {"statuses": [400, 403, 422]},
    "api_exchange.cfg": {"statuses": [400]},
    "api_exchange.export": {"statuses": [400]},
    "api_exchange.placement_cfg": {"statuses": [400]},
    "api_notes.change": {"parameters": [_IF_MATCH]},
    "api_notes.remove": {"parameters": [_IF_MATCH]},
    "api_people.list_accounts": {"statuses": [403]},
    "api_shares.list_shares": {"statuses": [403]},
    "maps.edit_one": {"parameters": [_IF_MATCH]},
    "maps.remove_one": {"parameters": [_IF_MATCH]},
    "api_uploads.send": chunks.OPERATION,
}
"""What routes read, and answer with, that no schema of theirs describes, by endpoint."""

_ERROR = {
    "type": "object",
    "required": ["error"],
    "properties": {
        "error": {
            "type": "object",
            "required": ["code", "message", "hint", "where"],
            "properties": {
                "code": {"type": "string", "description": "For programs: `not_found`, say."},
                "message": {"type": "string", "description": "For people: what is wrong, in one sentence."},
                "hint": {"type": ["string", "null"], "description": "How to fix it."},
                "where": {"type": ["string", "null"], "description": "The field or file it is about."},
            },
        }
    },
}

_PART = re.compile(r"<(?:(?P<kind>\w+)(?:\((?P<limits>[^)]*)\))?:)?(?P<name>\w+)>")
"""A part of a path that varies, as Flask writes it: `<slug>`, `<id:map_id>`, `<int(max=9):number>`."""


class Application(APIFlask):
    """APIFlask, whose document has each schema once, also where others hold it too.

    It is made for the first one who asks; others who ask meanwhile wait for it.
    """

    _document_lock = threading.Lock()

    def _get_spec(self, *args: Any, **options: Any) -> dict[str, Any] | str:
        with self._document_lock:
            return cast("dict[str, Any] | str", super()._get_spec(*args, **options))

    def _register_schema_and_get_ref(self, spec: APISpec, registered: Any, schema: Any) -> dict[str, str]:
        converter = self._ma_plugin.converter
        key = make_schema_key(resolve_schema_instance(schema))
        if converter is not None and key in converter.refs:
            return {"$ref": f"#/components/schemas/{converter.refs[key]}"}
        return super()._register_schema_and_get_ref(spec, registered, schema)


Responses = dict[int | str, dict[str, str | dict[str, dict[str, Any]]]]
"""As `blueprint.doc` takes them."""


def file_answer(description: str, *types: str) -> Responses:
    """Describe an answer that is a file, for `blueprint.doc(responses=...)`.

    Parameters
    ----------
    *types : str
        Media types that it can have.
    """
    return {200: {"description": description, "content": {kind: {"schema": {}} for kind in types}}}


def json_answer(description: str, schema: type[Schema], *, status: int = 200) -> Responses:
    """Describe an answer of another status, or one whose fields are too many to be copied one by one."""
    return {status: {"description": description, "content": {"application/json": {"schema": schema}}}}


def init_app(app: APIFlask) -> None:
    """Register the OpenAPI document."""
    app.description = _ABOUT
    app.servers = [{"url": "/"}]
    app.config.update(
        AUTO_404_RESPONSE=False,
        AUTO_VALIDATION_ERROR_RESPONSE=False,
        SECURITY_SCHEMES={
            "token": {"type": "http", "scheme": "bearer", "description": "Of the account page."},
        },
    )
    app.spec_processor(partial(_complete, app))


def _complete(app: Flask, document: dict[str, Any]) -> dict[str, Any]:
    """Add what all addresses have in common."""
    document["tags"] = [{"name": name, "description": text} for name, text in _TAGS.items()]
    document["security"] = [{"token": []}]
    _add_errors(document["components"])
    for rule, operation in _operations(app, document):
        more = (_MORE | dict(parts().operations)).get(rule.endpoint, {})
        operation["operationId"] = rule.endpoint.removeprefix("api_").replace(".", "_")
        operation["parameters"] += more.get("parameters", [])
        operation.update({"requestBody": more["requestBody"]} if "requestBody" in more else {})
        for parameter in operation["parameters"]:
            if parameter["in"] == "path":
                _describe(parameter, rule)
        if is_public(app.view_functions[rule.endpoint]):
            operation["security"] = []
        if "requestBody" in operation:
            operation["requestBody"]["required"] = _needs_body(operation["requestBody"], document)
        changes = "GET" not in (rule.methods or ())
        for status in [*_statuses(operation, changes=changes), *more.get("statuses", ())]:
            operation["responses"].setdefault(str(status), {"$ref": f"#/components/responses/Error{status}"})
    return document


def _operations(app: Flask, document: dict[str, Any]) -> Iterator[tuple[Rule, dict[str, Any]]]:
    """Yield each operation of the document with the rule that it stands for."""
    for rule in app.url_map.iter_rules():
        path = _PART.sub(r"{\g<name>}", rule.rule)
        for method in rule.methods or ():
            operation = document["paths"].get(path, {}).get(method.lower())
            if operation is not None:
                yield rule, operation


def _describe(parameter: dict[str, Any], rule: Rule) -> None:
    """Say what a part of the path means, and which values it can have at all."""
    name = parameter["name"]
    part = next(found for found in _PART.finditer(rule.rule) if found["name"] == name)
    limits = dict(re.findall(r"(\w+)=(\d+)", part["limits"] or ""))
    schema: dict[str, Any] = {"type": "string", "minLength": 1}
    if part["kind"] == "int":
        schema = {"type": "integer", "minimum": 0}
    if part["kind"] == "id":
        schema = {"type": "integer", "minimum": 0, "maximum": MAX_NUMBER}
    schema.update({bound: int(value) for key, value in limits.items() for bound in _LIMITS[key]})
    parameter.update(
        {"required": True, "schema": schema, **(_PARAMETERS | dict(parts().path_parameters))[name]}
    )


def _needs_body(body: dict[str, Any], document: dict[str, Any]) -> bool:
    """Return whether a body has a field that must be there."""
    for content in body["content"].values():
        name = content["schema"].get("$ref", "").rpartition("/")[2]
        if document["components"]["schemas"].get(name, content["schema"]).get("required"):
            return True
    return False


def _add_errors(components: dict[str, Any]) -> None:
    """Add the answers that are errors."""
    content = {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}
    components["schemas"]["Error"] = _ERROR
    components["responses"] = {
        f"Error{status}": {"description": text, "content": content} for status, text in _MEANINGS.items()
    }


def _statuses(operation: dict[str, Any], *, changes: bool) -> list[int]:
    """List the errors that an operation can answer with."""
    places = {parameter["in"] for parameter in operation["parameters"]}
    found = {*_ALWAYS}
    found.update(_OF_PATH if "path" in places else ())
    found.update((*_OF_PATH, *_OF_INPUT) if "query" in places else ())
    found.update((*_OF_INPUT, *_OF_BODY) if "requestBody" in operation else ())
    found.update((*_OF_CHANGE, *_OF_REVISION) if changes else ())
    return sorted(HTTPStatus(status) for status in found)
