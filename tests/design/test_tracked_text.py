"""No file contains hosts, options or paths of one machine or company, or unfinished parts."""

import re

import pytest

# One letter of each pattern is a character class, so that this file does not match itself.
HOSTS = r"pyp[i]\.org|python[h]osted|registry\.npm[j]s|anacond[a]\.org|deb\.debia[n]\.org"
OPTIONS = r"--(extra-)?index[-]url|--find[-]links|--trusted[-]host"
FOLDERS = r"(?<![\w.*])/(wor[k]|roo[t]|hom[e]|User[s])/|C:\\User[s]"
UNFINISHED = r"\b(TOD[O]|FIXM[E]|XX[X]|NotImplemented[E]rror)\b"


@pytest.fixture(scope="module")
def texts(tracked):
    """All tracked text files by path."""
    found = {}
    for path in tracked:
        data = path.read_bytes()
        if b"\0" not in data and "corpus" not in path.parent.name:
            found[path] = data.decode("utf-8")
    return found


def holding(texts, pattern):
    """Return the lines that match a pattern."""
    return [
        f"{path}:{number}: {line.strip()[:80]}"
        for path, text in texts.items()
        for number, line in enumerate(text.splitlines(), 1)
        if re.search(pattern, line)
    ]


def test_no_address_of_a_package_registry(texts):
    assert holding(texts, f"{HOSTS}|{OPTIONS}") == []


def test_no_path_of_one_machine(texts):
    assert holding(texts, FOLDERS) == []


def test_nothing_is_left_to_be_done(texts):
    assert holding(texts, UNFINISHED) == []


def test_large_files_stay_out(tracked, project):
    def limit(path):
        return 400_000 if "vendor" in path.parts else 300_000

    large = {str(p.relative_to(project)): p.stat().st_size for p in tracked if p.stat().st_size > limit(p)}
    assert large == {}
