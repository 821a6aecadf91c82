"""Pieces of photos: a pair joins nothing by itself; gaps name photos between which some are missing."""

import numpy as np

from webapp.core.landmarks.matching import Views, rank_pairs
from webapp.core.landmarks.pieces import Overlap, PieceGap, PieceGraph


def graph_of(count, *pairs):
    graph = PieceGraph(count)
    for one, other, inliers in pairs:
        graph.add(Overlap(one, other, 2 * inliers, inliers))
    return graph


def test_photos_are_joined_where_a_third_one_shows_the_same():
    graph = graph_of(5, (0, 1, 40), (1, 2, 40), (3, 4, 80))
    assert not graph.is_joined(0, 1)
    graph.add(Overlap(0, 2, 30, 20))
    assert graph.is_joined(0, 1)
    found = graph.result()
    assert found.pieces == ((0, 1, 2),)
    assert found.alone == (3, 4)


def test_few_inliers_join_nothing():
    assert graph_of(3, (0, 1, 11), (1, 2, 40), (0, 2, 40)).result().pieces == ()


def test_pieces_are_listed_from_the_largest_and_gaps_are_between_what_they_share():
    triangle = [(4, 5, 30), (5, 6, 30), (4, 6, 30)]
    square = [(0, 1, 30), (1, 2, 30), (0, 2, 30), (2, 3, 30), (1, 3, 30)]
    found = graph_of(8, *triangle, *square, (3, 4, 14), (0, 6, 20), (6, 7, 5)).result()
    assert found.pieces == ((0, 1, 2, 3), (4, 5, 6))
    assert found.bridges == (0, 3, 4, 6)
    assert found.gaps == (PieceGap(6, 0, 20), PieceGap(7, 6, 0))


def test_photos_with_nothing_in_common_are_connected_in_the_order_in_which_they_were_taken():
    found = graph_of(6, (0, 1, 30), (1, 2, 30), (0, 2, 30), (3, 4, 30), (4, 5, 30), (3, 5, 30)).result()
    assert found.gaps == (PieceGap(3, 2, 0),)
    assert found.bridges == ()


def test_two_photos_of_each_piece_far_from_each_other_are_placed_first():
    chain = [(n, n + step, 30) for n in range(9) for step in (1, 2) if n + step < 9]
    first, second = graph_of(9, *chain).result().place_first
    assert abs(first - second) >= 7


def test_no_photos_are_no_pieces():
    assert PieceGraph(0).result().gaps == ()
    assert PieceGraph(1).result().alone == (0,)


def test_the_most_promising_pairs_come_first_and_each_once(rng):
    descriptors = [rng.integers(0, 256, (60, 128), dtype=np.uint8) for _ in range(30)]
    descriptors[2] = descriptors[25] = rng.integers(0, 256, (60, 128), dtype=np.uint8)
    descriptors[9] = descriptors[9][:0]
    ranks = rank_pairs(descriptors, views=Views.none(30))
    assert {(0, 1), (2, 25)} <= set(ranks[0])
    every = [pair for rank in ranks for pair in rank]
    assert len(every) == len(set(every))
    assert all(one < other and 9 not in (one, other) for one, other in every)


def test_one_photo_has_no_pairs(rng):
    assert rank_pairs([rng.integers(0, 256, (60, 128), dtype=np.uint8)], views=Views.none(1)) == []
    assert rank_pairs([], views=Views.none(0)) == []
