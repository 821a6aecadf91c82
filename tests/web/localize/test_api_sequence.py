"""Frames sent one by one form a sequence, whichever process answers; hints of compass headings."""

import os
import time
from dataclasses import replace

import numpy as np
import pytest

from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MapExtrinsics, empty_depths
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.tasks.localize import spot, upload
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.plan import OpenOptions


def files(library):
    return list((library.inner / "sequences").glob("*.json"))


def first(answer):
    return answer.get_json()["hypotheses"][0]


def test_frames_before_count(client, sample, ask, queries, library):
    options = {"sequence": "walk-1", "keep": "false"}
    alone = ask(client, queries / "query_01.jpg", keep="false").get_json()
    answers = [ask(client, queries / "query_01.jpg", **options) for _ in range(3)]
    assert all(a.get_json()["sequence"] is True for a in answers)
    assert "sequence" not in alone
    assert len(files(library)) == 1
    gone = ask(client, queries / "off_map.jpg", **options)
    assert abs(first(gone)["x_px"] - first(answers[-1])["x_px"]) < 40
    assert first(gone)["probability"] > 0.1


def test_sequences_are_their_own(client, sample, ask, queries, library, sign_in, new_account, record):
    ana = new_account("Ana")
    with library.database.write() as session:
        accounts.set_member_role(session, session.merge(record()), account=ana, role="viewer")
    for browser, id in ((client, "a"), (client, "b"), (sign_in(ana), "a")):
        assert ask(browser, queries / "query_01.jpg", sequence=id).status_code == 200
    assert len(files(library)) == 3


def test_old_ones_are_forgotten(client, sample, ask, queries, library):
    ask(client, queries / "query_01.jpg", sequence="a")
    (old,) = files(library)
    past = time.time() - upload.SEQUENCE_EXPIRES_S - 1
    os.utime(old, (past, past))
    ask(client, queries / "query_01.jpg", sequence="b")
    assert old not in files(library) and len(files(library)) == 1


@pytest.mark.parametrize("id", ["", "../a", "x" * 65])
def test_odd_names_are_refused(client, sample, ask, queries, library, id):
    assert ask(client, queries / "query_01.jpg", sequence=id).status_code == 422
    assert not (library.inner / "sequences").exists()


def test_photos_without_a_heading_have_the_one_that_was_computed(library, sample):
    localizer = MapCache(library, Settings()).get(sample, OpenOptions()).pipeline
    indexed, experiences = localizer.opened.indexed, localizer.map.experiences
    turned = np.radians(np.where(np.arange(len(experiences)) % 2, 90.0, 270.0))
    trust = np.where(np.arange(len(experiences)) < 4, 0.0, 9.0)
    known = MapExtrinsics(so3.from_heading(turned), np.zeros(len(turned)), trust, empty_depths())
    object.__setattr__(indexed, "extrinsics", known)
    object.__setattr__(localizer.map, "experiences", tuple(replace(e, heading_deg=None) for e in experiences))
    headings = spot.photo_headings(localizer)
    expected = {int(i): 90.0 if n % 2 else 270.0 for n, i in enumerate(indexed.ids) if n >= 4}
    assert headings == pytest.approx(expected)
