"""TAK: missions in ATAK, WinTAK, iTAK and TAK servers, as Cursor-on-Target."""

from webapp.connect import Registration

CONNECTION = Registration("webapp.connect.tak.command:tak", "Send a mission to TAK, or receive one from it.")
