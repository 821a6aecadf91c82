"""The application on a separate library."""

from sqlalchemy import select

from tests.quick_apps import remember_rules
from tests.robot.wire import Wire
from webapp.app.web import create_app
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import Mission, MissionObject
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import open_library

remember_rules()


class Site:
    """A running application, and its stored data."""

    def __init__(self, folder):
        self.library = open_library(folder)
        with self.library.database.write() as session:
            owner = accounts.ensure_owner(session)
            self.token = accounts.new_token(session, owner, name="robot")
        self.mission = 0
        self.url = ""
        self.wire: Wire | None = None
        self.app = create_app(Settings(library=folder), library=self.library)

    def new_mission(self):
        with self.library.database.write() as session:
            owner = accounts.ensure_owner(session)
            self.mission = missions.create(session, "Yard", account_id=owner.id).id
        return self.mission

    def poses(self, mission=None):
        """Return the poses of the only track."""
        with self.library.database.read() as session:
            (track,) = tracks.list_tracks(session, mission or self.mission)
            return tracks.read(session, track)

    def state(self, mission=None):
        with self.library.database.read() as session:
            found = session.get_one(Mission, mission or self.mission)
            return found.name, found.start, found.ended_at is not None

    def summary(self, mission):
        """Return a summary of what a robot has sent."""
        with self.library.database.read() as session:
            objects = select(MissionObject.object_id).where(MissionObject.mission_id == mission)
            return {
                "tracks": [(track.source, track.poses) for track in tracks.list_tracks(session, mission)],
                "objects": list(session.scalars(objects)),
                "photos": len(missions.photos(session, mission)),
            }
