"""Names of public classes are unique: a search finds one definition."""

import ast
from collections import defaultdict


def test_no_two_public_classes_share_a_name(modules):
    places = defaultdict(list)
    for module in modules:
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(f"{module.name}:{node.lineno}")
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
