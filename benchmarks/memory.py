"""Memory of a program's processes, private and shared, from Linux's `/proc`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

_ROLES = {"webserver": "web server", " worker ": "background worker", " serve ": "supervisor"}

Table = dict[str, dict[str, float]]


def memory_mb(pid: int) -> Table:
    """Measure a process and its descendants.

    Returns:
    -------
    dict of str to dict of str to float
        For each process, and "all" for their sum, in 2^20 bytes: resident set size, proportional set size (a
        page shared by n processes counts 1/n in each) and its parts, private memory, and mapped index files.
        If processes share an index, the sum of `index_Pss` is about one `index_Rss`.
    """
    found: Table = {}
    for process in family(pid):
        try:
            command = Path(f"/proc/{process}/cmdline").read_text().replace("\0", " ")
            sizes = _sizes(Path(f"/proc/{process}"))
        except (FileNotFoundError, ProcessLookupError):
            continue
        role = next((role for word, role in _ROLES.items() if word in command), "another")
        found[f"{role} {process}"] = sizes
    total = {name: sum(sizes[name] for sizes in found.values()) for name in next(iter(found.values()))}
    return {**found, "all": total}


class PeakMemory:
    """The greatest memory of any process of a program, over what that process took when it was idle.

    Parameters
    ----------
    pid : int
        The program, which is idle now. A process that is started later counts in full.

    Attributes:
    ----------
    most_mb : float
        In 2^20 bytes, of resident memory; short-lived peaks are found too, but not those of processes that
        end before the next `look`.
    process : str
        Command line of that process.
    """

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._idle_mb: dict[int, float] = {}
        self.most_mb, self.process = 0.0, ""
        for process in family(pid):
            with suppress(OSError):
                Path(f"/proc/{process}/clear_refs").write_text("5")  # forget its peak so far
                self._idle_mb[process] = _peak_mb(process)

    def look(self) -> None:
        """Look at all processes."""
        for process in family(self._pid):
            with suppress(OSError, IndexError):  # it has just ended
                over = _peak_mb(process) - self._idle_mb.get(process, 0.0)
                if over > self.most_mb:
                    command = Path(f"/proc/{process}/cmdline").read_text().replace("\0", " ")
                    self.most_mb, self.process = over, command.strip()


def _peak_mb(process: int) -> float:
    status = Path(f"/proc/{process}/status").read_text()
    return float(status.partition("VmHWM:")[2].split()[0]) / 1024


def as_text(table: Table, *, title: str) -> str:
    """Format the figures as a table."""
    names = list(table["all"])
    lines = [f"{title:<26}" + "".join(f"{name:>11}" for name in names)]
    lines += [f"{who:<26}" + "".join(f"{sizes[n]:>11.0f}" for n in names) for who, sizes in table.items()]
    return "\n".join(lines)


def _sizes(process: Path) -> dict[str, float]:
    kb = {
        line.split(":")[0]: float(line.split()[1])
        for line in (process / "smaps_rollup").read_text().splitlines()[1:]
    }
    kb["private"] = kb["Private_Clean"] + kb["Private_Dirty"]
    for name in ("Rss", "Pss"):
        kb[f"index_{name}"] = _of_indexes(process, name)
    wanted = ("Rss", "Pss", "Pss_Anon", "Pss_File", "Pss_Shmem", "private", "index_Rss", "index_Pss")
    return {name: kb[name] / 1024 for name in wanted}


def _of_indexes(process: Path, name: str) -> float:
    """Sum up one of the sizes (kB) over the mapped files of indexes."""
    total, counts = 0.0, False
    for line in (process / "smaps").read_text().splitlines():
        key, *rest = line.split()
        if not key.endswith(":"):  # the first line of a mapping, which ends with its file
            counts = "/derived/" in line
        elif counts and key == f"{name}:":
            total += float(rest[0])
    return total


def family(pid: int) -> list[int]:
    """List a process and its descendants."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                stat = (entry / "stat").read_text()
            except (FileNotFoundError, ProcessLookupError):
                continue
            parents[int(entry.name)] = int(stat.rsplit(")", 1)[1].split()[1])
    found = [pid]
    for process in found:
        found += [child for child, parent in parents.items() if parent == process]
    return found
