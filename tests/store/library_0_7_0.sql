BEGIN TRANSACTION;
CREATE TABLE account (
	id INTEGER NOT NULL, 
	name VARCHAR NOT NULL, 
	password_hash VARCHAR, 
	is_owner BOOLEAN NOT NULL, 
	language VARCHAR, 
	epoch INTEGER NOT NULL, 
	created_at DATETIME NOT NULL, 
	CONSTRAINT pk_account PRIMARY KEY (id), 
	CONSTRAINT uq_account_name UNIQUE (name)
);
INSERT INTO "account" VALUES(1,'ana',NULL,1,NULL,5,'2024-05-18 15:00:00.000000');
CREATE TABLE alembic_version (
	version_num VARCHAR(32) NOT NULL, 
	CONSTRAINT alembic_version_pkc PRIMARY KEY (version_num)
);
INSERT INTO "alembic_version" VALUES('0007');
CREATE TABLE api_token (
	id INTEGER NOT NULL, 
	account_id INTEGER NOT NULL, 
	name VARCHAR NOT NULL, 
	token_hash VARCHAR NOT NULL, 
	created_at DATETIME NOT NULL, 
	used_at DATETIME, 
	CONSTRAINT pk_api_token PRIMARY KEY (id), 
	CONSTRAINT fk_api_token_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE CASCADE, 
	CONSTRAINT uq_api_token_account_id_name UNIQUE (account_id, name), 
	CONSTRAINT uq_api_token_token_hash UNIQUE (token_hash)
);
CREATE TABLE edit (
	id INTEGER NOT NULL, 
	map_id INTEGER NOT NULL, 
	account_id INTEGER, 
	at DATETIME NOT NULL, 
	kind VARCHAR NOT NULL, 
	changes JSON NOT NULL, 
	state VARCHAR NOT NULL, 
	turn INTEGER NOT NULL, 
	CONSTRAINT pk_edit PRIMARY KEY (id), 
	CONSTRAINT fk_edit_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE SET NULL, 
	CONSTRAINT fk_edit_map_id FOREIGN KEY(map_id) REFERENCES map (id) ON DELETE CASCADE
);
INSERT INTO "edit" VALUES(1,1,1,'2024-05-18 15:00:00.000000','place','[{"target": "photo/0", "before": {"x_px": null, "y_px": null}, "after": {"x_px": 10.0, "y_px": 5.0}}]','done',4);
CREATE TABLE failed_sign_in (
	id INTEGER NOT NULL, 
	who VARCHAR NOT NULL, 
	at DATETIME NOT NULL, 
	CONSTRAINT pk_failed_sign_in PRIMARY KEY (id)
);
CREATE TABLE "job" (
	id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	map_id INTEGER, 
	account_id INTEGER, 
	kind VARCHAR NOT NULL, 
	"key" VARCHAR NOT NULL, 
	arguments JSON NOT NULL, 
	state VARCHAR NOT NULL, 
	done INTEGER NOT NULL, 
	total INTEGER NOT NULL, 
	note VARCHAR NOT NULL, 
	error JSON, 
	result JSON, 
	attempts INTEGER NOT NULL, 
	cancel_wanted BOOLEAN NOT NULL, 
	fence INTEGER NOT NULL, 
	leased_by VARCHAR, 
	leased_until DATETIME, 
	created_at DATETIME NOT NULL, 
	started_at DATETIME, 
	ended_at DATETIME, 
	CONSTRAINT fk_job_map_id FOREIGN KEY(map_id) REFERENCES map (id) ON DELETE CASCADE, 
	CONSTRAINT fk_job_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE SET NULL
);
INSERT INTO "job" VALUES(1,NULL,NULL,'index','a','{}','queued',0,0,'',NULL,NULL,0,0,0,NULL,NULL,'2024-05-18 15:00:00.000000',NULL,NULL);
CREATE TABLE map (
	id INTEGER NOT NULL, 
	slug VARCHAR NOT NULL, 
	name VARCHAR NOT NULL, 
	created_at DATETIME NOT NULL, 
	changed_at DATETIME NOT NULL, 
	binned_at DATETIME, 
	revision INTEGER NOT NULL, 
	next_id INTEGER NOT NULL, 
	satellite_path VARCHAR, 
	satellite_width INTEGER, 
	satellite_height INTEGER, 
	georeference JSON, 
	satellite_revision INTEGER NOT NULL, 
	exported_revision INTEGER NOT NULL, 
	exported_sha256 VARCHAR, 
	previous_sha256 VARCHAR, 
	CONSTRAINT pk_map PRIMARY KEY (id), 
	CONSTRAINT uq_map_slug UNIQUE (slug)
);
INSERT INTO "map" VALUES(1,'park','Park','2024-05-18 15:00:00.000000','2024-05-18 15:00:00.000000',NULL,4,1,'plan.png',100,80,NULL,1,-1,NULL,NULL);
CREATE TABLE member (
	map_id INTEGER NOT NULL, 
	account_id INTEGER NOT NULL, 
	role VARCHAR NOT NULL, 
	CONSTRAINT pk_member PRIMARY KEY (map_id, account_id), 
	CONSTRAINT fk_member_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE CASCADE, 
	CONSTRAINT fk_member_map_id FOREIGN KEY(map_id) REFERENCES map (id) ON DELETE CASCADE
);
CREATE TABLE mission (
	id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	name VARCHAR NOT NULL, 
	map_id INTEGER, 
	account_id INTEGER, 
	created_at DATETIME NOT NULL, 
	changed_at DATETIME NOT NULL, 
	binned_at DATETIME, 
	start JSON, 
	note VARCHAR NOT NULL, 
	revision INTEGER NOT NULL, 
	ended_at DATETIME, 
	CONSTRAINT fk_mission_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE SET NULL, 
	CONSTRAINT fk_mission_map_id FOREIGN KEY(map_id) REFERENCES map (id) ON DELETE SET NULL
);
INSERT INTO "mission" VALUES(1,'Walk',NULL,1,'2024-05-18 15:00:00.000000','2024-05-18 15:00:00.000000',NULL,NULL,'',0,NULL);
CREATE TABLE mission_batch (
	mission_id INTEGER NOT NULL, 
	"key" VARCHAR NOT NULL, 
	answer JSON NOT NULL, 
	at DATETIME NOT NULL, 
	CONSTRAINT pk_mission_batch PRIMARY KEY (mission_id, "key"), 
	CONSTRAINT fk_mission_batch_mission_id FOREIGN KEY(mission_id) REFERENCES mission (id) ON DELETE CASCADE
);
CREATE TABLE mission_object (
	mission_id INTEGER NOT NULL, 
	object_id VARCHAR NOT NULL, 
	kind VARCHAR NOT NULL, 
	first_time_s DOUBLE NOT NULL, 
	last_time_s DOUBLE NOT NULL, 
	lat DOUBLE NOT NULL, 
	lon DOUBLE NOT NULL, 
	height_m DOUBLE, 
	confidence DOUBLE, 
	photo_sha VARCHAR, 
	sightings INTEGER NOT NULL, 
	revision INTEGER NOT NULL, 
	CONSTRAINT pk_mission_object PRIMARY KEY (mission_id, object_id), 
	CONSTRAINT fk_mission_object_mission_id FOREIGN KEY(mission_id) REFERENCES mission (id) ON DELETE CASCADE
);
CREATE TABLE mission_photo (
	mission_id INTEGER NOT NULL, 
	sha256 VARCHAR NOT NULL, 
	name VARCHAR NOT NULL, 
	path VARCHAR NOT NULL, 
	width INTEGER NOT NULL, 
	height INTEGER NOT NULL, 
	size_bytes INTEGER NOT NULL, 
	time_s DOUBLE, 
	object_id VARCHAR, 
	fix JSON, 
	fix_state VARCHAR, 
	CONSTRAINT pk_mission_photo PRIMARY KEY (mission_id, sha256), 
	CONSTRAINT fk_mission_photo_mission_id FOREIGN KEY(mission_id) REFERENCES mission (id) ON DELETE CASCADE
);
CREATE TABLE mission_sender (
	mission_id INTEGER NOT NULL, 
	sender VARCHAR NOT NULL, 
	next_seq INTEGER NOT NULL, 
	seen_at DATETIME NOT NULL, 
	CONSTRAINT pk_mission_sender PRIMARY KEY (mission_id, sender), 
	CONSTRAINT fk_mission_sender_mission_id FOREIGN KEY(mission_id) REFERENCES mission (id) ON DELETE CASCADE
);
CREATE TABLE mission_share (
	id INTEGER NOT NULL, 
	mission_id INTEGER NOT NULL, 
	token_hash VARCHAR NOT NULL, 
	public_token VARCHAR, 
	account_id INTEGER, 
	created_at DATETIME NOT NULL, 
	photos BOOLEAN NOT NULL, 
	CONSTRAINT pk_mission_share PRIMARY KEY (id), 
	CONSTRAINT fk_mission_share_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE SET NULL, 
	CONSTRAINT fk_mission_share_mission_id FOREIGN KEY(mission_id) REFERENCES mission (id) ON DELETE CASCADE, 
	CONSTRAINT uq_mission_share_token_hash UNIQUE (token_hash)
);
INSERT INTO "mission_share" VALUES(1,1,'e982cd0c9e9e6a6873c89d8db07fc683317faff4ec2a78c0a23b84232ff9c7ff',NULL,1,'2024-05-18 15:00:00.000000',1);
INSERT INTO "mission_share" VALUES(2,1,'dbbabe95ef65f3c8139c20301cef604b5a3822c8fa5598088ea5519568d5c991','mission-public',1,'2024-05-18 15:00:00.000000',0);
CREATE TABLE photo (
	map_id INTEGER NOT NULL, 
	id INTEGER NOT NULL, 
	name VARCHAR NOT NULL, 
	path VARCHAR NOT NULL, 
	sha256 VARCHAR NOT NULL, 
	size_bytes INTEGER NOT NULL, 
	width INTEGER NOT NULL, 
	height INTEGER NOT NULL, 
	uploaded_at DATETIME NOT NULL, 
	taken_at VARCHAR, 
	fov_deg DOUBLE, 
	gps_lat DOUBLE, 
	gps_lon DOUBLE, 
	gps_accuracy_m DOUBLE, 
	gps_problem VARCHAR, 
	x_px DOUBLE, 
	y_px DOUBLE, 
	heading_deg DOUBLE, 
	removed BOOLEAN NOT NULL, 
	revision INTEGER NOT NULL, blurred JSON, 
	CONSTRAINT pk_photo PRIMARY KEY (map_id, id), 
	CONSTRAINT fk_photo_map_id FOREIGN KEY(map_id) REFERENCES map (id) ON DELETE CASCADE, 
	CONSTRAINT uq_photo_map_id_sha256 UNIQUE (map_id, sha256)
);
INSERT INTO "photo" VALUES(1,0,'a.jpg','photos/a.jpg','00',1,4,3,'2024-05-18 15:00:00.000000',NULL,NULL,NULL,NULL,NULL,NULL,10.0,5.0,NULL,0,4,NULL);
CREATE TABLE placed_elsewhere (
	map_id INTEGER NOT NULL, 
	placement VARCHAR NOT NULL, 
	photo_id INTEGER NOT NULL, 
	x_px DOUBLE NOT NULL, 
	y_px DOUBLE NOT NULL, 
	CONSTRAINT pk_placed_elsewhere PRIMARY KEY (map_id, placement, photo_id), 
	CONSTRAINT fk_placed_elsewhere_map_id FOREIGN KEY(map_id) REFERENCES map (id) ON DELETE CASCADE
);
CREATE TABLE pose (
	track_id INTEGER NOT NULL, 
	number INTEGER NOT NULL, 
	time_s DOUBLE NOT NULL, 
	lat DOUBLE NOT NULL, 
	lon DOUBLE NOT NULL, 
	height_m DOUBLE, 
	heading_deg DOUBLE, 
	var_e DOUBLE, 
	var_n DOUBLE, 
	cov_en DOUBLE, 
	travelled_m DOUBLE NOT NULL, 
	CONSTRAINT pk_pose PRIMARY KEY (track_id, number), 
	CONSTRAINT fk_pose_track_id FOREIGN KEY(track_id) REFERENCES track (id) ON DELETE CASCADE
)
 WITHOUT ROWID

;
CREATE TABLE "query" (
	id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	map_id INTEGER NOT NULL, 
	account_id INTEGER, 
	at DATETIME NOT NULL, 
	name VARCHAR NOT NULL, 
	file VARCHAR NOT NULL, 
	width INTEGER NOT NULL, 
	height INTEGER NOT NULL, 
	options JSON NOT NULL, 
	answer JSON NOT NULL, 
	evidence JSON NOT NULL, 
	adopted_id INTEGER, "key" VARCHAR, 
	CONSTRAINT fk_query_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE SET NULL, 
	CONSTRAINT fk_query_map_id FOREIGN KEY(map_id) REFERENCES map (id) ON DELETE CASCADE
);
INSERT INTO "query" VALUES(1,1,1,'2024-05-18 15:00:00.000000','q.jpg','q.jpg',4,3,'{}','{"hypotheses": []}','[]',NULL,NULL);
CREATE TABLE share (
	id INTEGER NOT NULL, 
	map_id INTEGER NOT NULL, 
	query_id INTEGER, 
	token_hash VARCHAR NOT NULL, 
	public_token VARCHAR, 
	account_id INTEGER, 
	created_at DATETIME NOT NULL, 
	photos BOOLEAN NOT NULL, 
	localize BOOLEAN NOT NULL, 
	originals BOOLEAN NOT NULL, 
	CONSTRAINT pk_share PRIMARY KEY (id), 
	CONSTRAINT fk_share_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE SET NULL, 
	CONSTRAINT fk_share_map_id FOREIGN KEY(map_id) REFERENCES map (id) ON DELETE CASCADE, 
	CONSTRAINT fk_share_query_id FOREIGN KEY(query_id) REFERENCES "query" (id) ON DELETE CASCADE, 
	CONSTRAINT uq_share_token_hash UNIQUE (token_hash)
);
INSERT INTO "share" VALUES(1,1,NULL,'490da8df99aa53d97966001a936b43b856be6481a052a2b56b2d3db6ebb4019a',NULL,1,'2024-05-18 15:00:00.000000',1,1,0);
INSERT INTO "share" VALUES(2,1,1,'2b6c49883560fe0106fb435caf9eecdfab24293379415fc62d37e1fec075579a','answer-public',1,'2024-05-18 15:00:00.000000',0,0,1);
CREATE TABLE sighting (
	mission_id INTEGER NOT NULL, 
	object_id VARCHAR NOT NULL, 
	number INTEGER NOT NULL, 
	time_s DOUBLE NOT NULL, 
	lat DOUBLE NOT NULL, 
	lon DOUBLE NOT NULL, 
	height_m DOUBLE, 
	confidence DOUBLE, 
	photo_sha VARCHAR, 
	CONSTRAINT pk_sighting PRIMARY KEY (mission_id, object_id, number), 
	CONSTRAINT fk_sighting_mission_id FOREIGN KEY(mission_id) REFERENCES mission (id) ON DELETE CASCADE
);
CREATE TABLE sign_in_link (
	token_hash VARCHAR NOT NULL, 
	account_id INTEGER NOT NULL, 
	expires_at DATETIME NOT NULL, 
	used_at DATETIME, 
	CONSTRAINT pk_sign_in_link PRIMARY KEY (token_hash), 
	CONSTRAINT fk_sign_in_link_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE CASCADE
);
CREATE TABLE track (
	id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	mission_id INTEGER NOT NULL, 
	source VARCHAR NOT NULL, 
	name VARCHAR NOT NULL, 
	poses INTEGER NOT NULL, 
	skipped INTEGER NOT NULL, 
	distance_m DOUBLE NOT NULL, 
	first_time_s DOUBLE, 
	last_time_s DOUBLE, 
	min_lat DOUBLE, 
	max_lat DOUBLE, 
	min_lon DOUBLE, 
	max_lon DOUBLE, 
	built_to INTEGER NOT NULL, timed BOOLEAN DEFAULT 1 NOT NULL, 
	CONSTRAINT fk_track_mission_id FOREIGN KEY(mission_id) REFERENCES mission (id) ON DELETE CASCADE, 
	CONSTRAINT uq_track_mission_id_source_name UNIQUE (mission_id, source, name)
);
CREATE TABLE track_piece (
	track_id INTEGER NOT NULL, 
	level INTEGER NOT NULL, 
	chunk INTEGER NOT NULL, 
	first_number INTEGER NOT NULL, 
	count INTEGER NOT NULL, 
	min_lat DOUBLE NOT NULL, 
	max_lat DOUBLE NOT NULL, 
	min_lon DOUBLE NOT NULL, 
	max_lon DOUBLE NOT NULL, 
	first_time_s DOUBLE NOT NULL, 
	last_time_s DOUBLE NOT NULL, 
	points BLOB NOT NULL, 
	CONSTRAINT pk_track_piece PRIMARY KEY (track_id, level, chunk), 
	CONSTRAINT fk_track_piece_track_id FOREIGN KEY(track_id) REFERENCES track (id) ON DELETE CASCADE
);
CREATE TABLE track_profile (
	track_id INTEGER NOT NULL, 
	chunk INTEGER NOT NULL, 
	points BLOB NOT NULL, 
	CONSTRAINT pk_track_profile PRIMARY KEY (track_id, chunk), 
	CONSTRAINT fk_track_profile_track_id FOREIGN KEY(track_id) REFERENCES track (id) ON DELETE CASCADE
);
CREATE TABLE upload (
	id VARCHAR NOT NULL, 
	map_id INTEGER NOT NULL, 
	account_id INTEGER NOT NULL, 
	fingerprint VARCHAR NOT NULL, 
	name VARCHAR NOT NULL, 
	size_bytes INTEGER NOT NULL, 
	created_at DATETIME NOT NULL, 
	CONSTRAINT pk_upload PRIMARY KEY (id), 
	CONSTRAINT fk_upload_account_id FOREIGN KEY(account_id) REFERENCES account (id) ON DELETE CASCADE, 
	CONSTRAINT fk_upload_map_id FOREIGN KEY(map_id) REFERENCES map (id) ON DELETE CASCADE, 
	CONSTRAINT uq_upload_map_id_account_id_fingerprint UNIQUE (map_id, account_id, fingerprint)
);
CREATE INDEX ix_failed_sign_in_who_failed_sign_in_at ON failed_sign_in (who, at);
CREATE INDEX ix_edit_map_id_edit_account_id_edit_state ON edit (map_id, account_id, state);
CREATE INDEX ix_member_account_id ON member (account_id);
CREATE INDEX ix_photo_map_id_photo_revision ON photo (map_id, revision);
CREATE INDEX ix_upload_created_at ON upload (created_at);
CREATE INDEX ix_query_map_id_query_id ON "query" (map_id, id);
CREATE UNIQUE INDEX uq_query_key ON "query" (map_id, account_id, "key");
CREATE INDEX ix_share_map_id ON share (map_id);
CREATE INDEX ix_mission_account_id ON mission (account_id);
CREATE INDEX ix_mission_map_id ON mission (map_id);
CREATE INDEX ix_mission_share_mission_id ON mission_share (mission_id);
CREATE INDEX ix_mission_object_mission_id_mission_object_kind ON mission_object (mission_id, kind);
CREATE INDEX ix_mission_object_mission_id_mission_object_revision ON mission_object (mission_id, revision);
CREATE INDEX ix_mission_batch_mission_id_mission_batch_at ON mission_batch (mission_id, at);
CREATE UNIQUE INDEX uq_job_waiting ON job (map_id, kind, "key") WHERE state = 'queued';
CREATE INDEX ix_job_state_job_created_at ON job (state, created_at);
CREATE INDEX ix_job_map_id ON job (map_id);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('job',1);
INSERT INTO "sqlite_sequence" VALUES('query',1);
INSERT INTO "sqlite_sequence" VALUES('mission',1);
COMMIT;
