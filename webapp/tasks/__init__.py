"""The use cases: functions that take settings and a `Progress` and return a report, for every front end."""
