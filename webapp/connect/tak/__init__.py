"""TAK: missions in ATAK, WinTAK, iTAK and TAK servers, as Cursor-on-Target."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.tak.command:tak", "Send tracks and objects of MISSION to TAK, or write a data package."
)
