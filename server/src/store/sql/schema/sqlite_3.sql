-- Stored bytes: which generation of each digest counts, and who refers to it.

CREATE TABLE chunks (
    digest     TEXT PRIMARY KEY,
    generation INTEGER,                                          -- NULL: the bytes are lost
    bytes      INTEGER NOT NULL,
    refs       INTEGER NOT NULL DEFAULT 0 CHECK (refs >= 0),     -- rows of result_chunks and bake_chunks
    used_ms    INTEGER NOT NULL                                  -- last asked for, with a grain
) STRICT, WITHOUT ROWID;

CREATE INDEX chunks_without_references ON chunks (used_ms, digest) WHERE refs = 0;

-- Names whose bytes are to be removed. Dead for good, also when somebody stores the same bytes again.
CREATE TABLE condemned (
    digest     TEXT NOT NULL,
    generation INTEGER NOT NULL,
    bytes      INTEGER NOT NULL,
    PRIMARY KEY (digest, generation)
) STRICT, WITHOUT ROWID;

-- Sums over chunks that are not lost, and condemned ones.
CREATE TABLE storage_usage (
    id     INTEGER PRIMARY KEY CHECK (id = 1),
    chunks INTEGER NOT NULL,
    bytes  INTEGER NOT NULL
) STRICT;

-- Outputs of results.
CREATE TABLE result_chunks (
    task   INTEGER NOT NULL REFERENCES results (task) ON DELETE CASCADE,
    digest TEXT NOT NULL REFERENCES chunks (digest),
    PRIMARY KEY (task, digest)
) STRICT, WITHOUT ROWID;

CREATE INDEX result_chunks_by_digest ON result_chunks (digest);

-- Scenes of bakes, and artefacts that their tasks name.
CREATE TABLE bake_chunks (
    bake   INTEGER NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    digest TEXT NOT NULL REFERENCES chunks (digest),
    PRIMARY KEY (bake, digest)
) STRICT, WITHOUT ROWID;

CREATE INDEX bake_chunks_by_digest ON bake_chunks (digest);

CREATE INDEX bakes_by_end ON bakes (finished_ms) WHERE finished_ms IS NOT NULL;

-- What was stored before has generation 0; the lengths of scenes are not known here: they are found when asked for.
INSERT INTO chunks (digest, generation, bytes, used_ms)
    SELECT o.value ->> 'digest', 0, max(o.value ->> 'bytes'), 0 FROM results r, json_each(r.outputs) o GROUP BY 1;
INSERT INTO chunks (digest, generation, bytes, used_ms)
    SELECT DISTINCT scene, NULL, 0, 0 FROM bakes WHERE true ON CONFLICT DO NOTHING;

CREATE TRIGGER result_chunks_come AFTER INSERT ON result_chunks BEGIN
    UPDATE chunks SET refs = refs + 1 WHERE digest = NEW.digest;
END;
CREATE TRIGGER result_chunks_go AFTER DELETE ON result_chunks BEGIN
    UPDATE chunks SET refs = refs - 1 WHERE digest = OLD.digest;
END;
CREATE TRIGGER bake_chunks_come AFTER INSERT ON bake_chunks BEGIN
    UPDATE chunks SET refs = refs + 1 WHERE digest = NEW.digest;
END;
CREATE TRIGGER bake_chunks_go AFTER DELETE ON bake_chunks BEGIN
    UPDATE chunks SET refs = refs - 1 WHERE digest = OLD.digest;
END;

INSERT INTO storage_usage SELECT 1, count(generation), coalesce(sum(bytes), 0) FROM chunks;
INSERT INTO result_chunks SELECT DISTINCT r.task, o.value ->> 'digest' FROM results r, json_each(r.outputs) o;
INSERT INTO bake_chunks SELECT seq, scene FROM bakes;
