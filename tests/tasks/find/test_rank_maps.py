"""The maps of a library are ranked by the similarity of their photos to a query."""

import shutil

import pytest
from sqlalchemy import select

from webapp.errors import NotReady
from webapp.progress import Progress
from webapp.store.maps import maps
from webapp.store.maps import photo_vectors as stored
from webapp.store.operate import jobs
from webapp.store.schema import Account, MapRecord
from webapp.tasks.find import describe_library, find_map
from webapp.tasks.find.find_map import MapRanking
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.upload import UploadedPhoto
from webapp.tasks.maps import adopt_map, delete_map

PHOTOS = 6
SLUGS = ("fen", "hill", "park")


@pytest.fixture(autouse=True)
def least_maps(monkeypatch):
    """Describe libraries with two or more maps."""
    monkeypatch.setattr(describe_library, "LEAST_MAPS", 2)


@pytest.fixture
def library(tmp_path, new_library):
    return new_library(tmp_path / "library")


@pytest.fixture
def owner(library):
    with library.database.write() as session:
        account = Account(name="ana", is_owner=True)
        session.add(account)
    return account.id


@pytest.fixture(scope="module")
def built(tmp_path_factory, make_map, save_photo, build):
    """Folders of maps with an index, of different photos; read-only."""
    base = tmp_path_factory.mktemp("built")
    for place, slug in enumerate(SLUGS):
        cfg = make_map(base / slug, PHOTOS)
        for number, photo in enumerate(sorted(cfg.parent.rglob("*.jpg"))):
            save_photo(photo, _seed(place, number))
        build(cfg)
    return base


@pytest.fixture
def add_map(library, owner, built):
    """Put one of the maps into the library and return its id."""

    def add(slug):
        shutil.copytree(built / slug, library.map_folder(slug))
        return adopt_map.adopt_map(library, slug, account_id=owner)

    return add


@pytest.fixture
def three(add_map):
    return {slug: add_map(slug) for slug in SLUGS}


@pytest.fixture
def describe(library, quick):
    """Describe maps, then run the job that this may queue."""

    def run(*map_ids):
        common = {"settings": quick, "writes": library.database.write, "progress": Progress()}
        for id in map_ids:
            describe_library.describe_map(library, id, **common)
        with library.database.write() as session:
            queued = [job for job in jobs.list_jobs(session) if job.state == "queued"]
            waiting = [job for job in queued if job.kind == describe_library.JOB]
            for job in waiting:
                jobs.cancel(session, job)
        for _ in waiting:
            describe_library.renew_basis(library, **common)
        return len(waiting)

    return run


@pytest.fixture
def ranked(library, quick, save_photo, tmp_path):
    """Rank all maps for a photo of one of the places and return their slugs."""
    ranking = MapRanking(library, quick)

    def run(place, number=2):
        save_photo(query := tmp_path / "query.jpg", _seed(place, number))
        with library.database.read() as session:
            records = session.scalars(select(MapRecord).order_by(MapRecord.id)).all()
        found = ranking.rank(records, query)
        return [record.slug for record in (*found.alike, *found.unknown)]

    return run


def _seed(place, number):
    return 100 * place + number


def test_the_map_that_shows_the_place_is_the_first(three, describe, ranked):
    assert describe(*three.values()) == 1, "one basis for all of them"
    assert [ranked(place)[0] for place in range(3)] == [*SLUGS]


def test_without_vectors_maps_stay_in_their_order(three, ranked):
    assert ranked(2) == [*SLUGS]


def test_a_map_that_comes_later_is_described_with_the_same_basis(add_map, describe, ranked, library):
    describe(add_map("fen"), add_map("park"))
    assert sorted(ranked(0)) == ["fen", "park"]
    hill = add_map("hill")
    assert ranked(1)[-1] == "hill", "it has no vectors yet, and is the last"
    with library.database.read() as session:
        (before,) = stored.bases(session)
    assert describe(hill) == 0
    with library.database.read() as session:
        assert [basis.id for basis in stored.bases(session)] == [before.id]
        assert stored.count_described(session, basis_id=before.id) == 3 * PHOTOS
    assert ranked(1)[0] == "hill"


def test_few_maps_need_no_basis_and_get_one_with_the_next(add_map, describe, ranked, library, monkeypatch):
    monkeypatch.setattr(describe_library, "LEAST_MAPS", 3)
    assert describe(add_map("fen"), add_map("hill")) == 0
    with library.database.read() as session:
        assert stored.bases(session) == []
    assert ranked(1) == ["fen", "hill"], "in their order"
    assert describe(add_map("park")) == 1
    assert [ranked(place)[0] for place in range(3)] == [*SLUGS]


def test_few_maps_that_are_left_need_no_other_basis(add_map, describe, library, monkeypatch):
    fen, hill = add_map("fen"), add_map("hill")
    assert describe(fen, hill) == 1
    with library.database.write() as session:
        maps.put_into_bin(session.get_one(MapRecord, hill))
    delete_map.delete_map(library, hill)
    monkeypatch.setattr(describe_library, "GROWTH", 0)
    assert describe(fen) == 0
    with library.database.read() as session:
        (basis,) = stored.bases(session)
    assert basis.ready


def test_a_map_that_comes_while_a_basis_is_trained_is_described(
    add_map, describe, ranked, library, quick, monkeypatch
):
    train = describe_library.global_descriptors.train_basis
    fen, hill = add_map("fen"), add_map("hill")

    def slow(photos):
        describe_library.describe_map(library, add_map("park"), **common)
        return train(photos)

    common = {"settings": quick, "writes": library.database.write, "progress": Progress()}
    monkeypatch.setattr(describe_library.global_descriptors, "train_basis", slow)
    assert describe(fen, hill) == 1
    with library.database.read() as session:
        (basis,) = stored.bases(session)
        assert stored.count_described(session, basis_id=basis.id) == 3 * PHOTOS
    assert ranked(2)[0] == "park"


def test_a_library_of_four_times_as_many_photos_gets_a_new_basis(
    add_map, describe, ranked, library, monkeypatch
):
    monkeypatch.setattr(describe_library, "GROWTH", 1.4)
    assert describe(add_map("fen"), add_map("hill")) == 1
    assert describe(add_map("park")) == 1
    with library.database.read() as session:
        (basis,) = stored.bases(session)
        assert basis.ready and basis.photos == 3 * PHOTOS
    assert [ranked(place)[0] for place in range(3)] == [*SLUGS]


def test_photos_that_are_on_two_maps_do_not_make_a_library_outgrow_its_basis(
    add_map, built, library, describe, monkeypatch
):
    monkeypatch.setattr(describe_library, "GROWTH", 2)
    shutil.copytree(built / "fen", built / "copy", dirs_exist_ok=True)
    both = [add_map("fen"), add_map("copy")]
    assert describe(*both) == 1
    assert describe(*both) == 0


def test_interrupted_it_goes_on_and_searches_use_the_old_basis(
    three, describe, ranked, library, quick, monkeypatch
):
    describe(*three.values())
    monkeypatch.setattr(describe_library, "GROWTH", 1)
    common = {"settings": quick, "writes": library.database.write}
    calls = []

    class Killed(Progress):
        def advance(self, steps=1):
            calls.append(steps)
            if len(calls) == 2:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        describe_library.renew_basis(library, progress=Killed(), **common)
    with library.database.read() as session:
        old, new = stored.bases(session)
        kept = stored.versions(session, basis_id=new.id)
    assert old.ready and not new.ready and len(kept) == 2
    assert ranked(1)[0] == "hill"
    assert describe_library.renew_basis(library, progress=Progress(), **common) == 3 * PHOTOS
    with library.database.read() as session:
        (basis,) = stored.bases(session)
        assert basis.id == new.id and basis.ready
        assert kept.items() <= stored.versions(session, basis_id=new.id).items(), "not described again"
    assert ranked(1)[0] == "hill"


def test_what_is_deleted_is_not_found(three, describe, ranked, library):
    describe(*three.values())
    assert ranked(1)[0] == "hill"
    with library.database.write() as session:
        maps.put_into_bin(session.get_one(MapRecord, three["hill"]))
    delete_map.delete_map(library, three["hill"])
    assert sorted(ranked(1)) == ["fen", "park"]


def test_a_damaged_index_leaves_the_other_maps_to_be_found(three, describe, ranked, library):
    for segment in library.map_folder("park").rglob("*.features"):
        segment.write_bytes(b"cut off")
    describe(*three.values())
    assert ranked(0)[0] == "fen" and ranked(1)[0] == "hill"


@pytest.fixture
def search(library, quick, save_photo, tmp_path, monkeypatch):
    """Search all maps for a photo of the hill, localizing it on at most one.

    Return the answer, and the maps that were searched, which do not find it.
    """
    monkeypatch.setattr(find_map, "MOST_MAPS", 1)
    cache, ranking = MapCache(library, quick), MapRanking(library, quick)

    def run():
        asked = []

        def localize(_cache, id, **_request):
            asked.append(id)
            raise NotReady("no index")

        monkeypatch.setattr(find_map.upload, "localize_uploads", localize)
        save_photo(query := tmp_path / "query.jpg", _seed(1, 2))
        with library.database.read() as session:
            records = session.scalars(select(MapRecord).order_by(MapRecord.id)).all()
        photo = UploadedPhoto(query, query.name)
        with_what = find_map.LibrarySearch(cache, ranking, quick)
        return find_map.find_map(with_what, records, photo=photo), asked

    return run


def test_maps_that_are_not_described_yet_are_searched_and_do_not_count_as_less_alike(
    add_map, describe, search
):
    fen, hill = add_map("fen"), add_map("hill")
    found, asked = search()
    assert asked == [fen, hill] and found.less_alike == 0, "nobody has compared them"
    describe(fen, hill)
    park = add_map("park")
    found, asked = search()
    assert asked == [hill, park]
    assert found.less_alike == 1
    assert [one.slug for one in found.not_searched] == ["hill", "park"]
    assert found.no_map_probability == 1.0


def test_maps_that_are_not_described_yet_are_named_when_the_time_is_over(
    add_map, describe, search, monkeypatch
):
    describe(add_map("fen"), add_map("hill"))
    add_map("park")
    monkeypatch.setattr(find_map, "BUDGET_S", -1.0)
    found, asked = search()
    assert asked == []
    assert [one.slug for one in found.not_searched] == ["hill", "park"]


def test_a_map_that_comes_back_from_the_bin_is_compared(three, describe, search, library):
    with library.database.write() as session:
        maps.put_into_bin(session.get_one(MapRecord, three["hill"]))
    describe(three["fen"], three["park"])
    with library.database.write() as session:
        maps.take_from_bin(session.get_one(MapRecord, three["hill"]))
    found, asked = search()
    assert asked == [three["hill"]] and found.less_alike == 2
