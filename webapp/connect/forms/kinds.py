"""The kind of the jobs that take over an export; without the libraries that read it."""

from webapp.jobs.kinds import JobRegistry, Kind

JOBS = JobRegistry(kinds={"field-form": Kind("webapp.connect.forms.importing:import_uploaded", short=True)})
