-- Stored bytes: which generation of each digest counts, and who refers to it.

CREATE TABLE chunks (
    digest     TEXT COLLATE "C" PRIMARY KEY,
    generation BIGINT,                                           -- NULL: the bytes are lost
    bytes      BIGINT NOT NULL,
    refs       BIGINT NOT NULL DEFAULT 0 CHECK (refs >= 0),      -- rows of result_chunks and bake_chunks
    used_ms    BIGINT NOT NULL                                   -- last asked for, with a grain
) WITH (fillfactor = 80);

CREATE INDEX chunks_without_references ON chunks (used_ms, digest) WHERE refs = 0;

-- Names whose bytes are to be removed. Dead for good, also when somebody stores the same bytes again.
CREATE TABLE condemned (
    digest     TEXT COLLATE "C" NOT NULL,
    generation BIGINT NOT NULL,
    bytes      BIGINT NOT NULL,
    PRIMARY KEY (digest, generation)
);

-- Sums over chunks that are not lost, and condemned ones.
CREATE TABLE storage_usage (
    id     BIGINT PRIMARY KEY CHECK (id = 1),
    chunks BIGINT NOT NULL,
    bytes  BIGINT NOT NULL
) WITH (fillfactor = 10);

-- Outputs of results.
CREATE TABLE result_chunks (
    task   BIGINT NOT NULL REFERENCES results (task) ON DELETE CASCADE,
    digest TEXT COLLATE "C" NOT NULL REFERENCES chunks (digest),
    PRIMARY KEY (task, digest)
);

CREATE INDEX result_chunks_by_digest ON result_chunks (digest);

-- Scenes of bakes, and artefacts that their tasks name.
CREATE TABLE bake_chunks (
    bake   BIGINT NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    digest TEXT COLLATE "C" NOT NULL REFERENCES chunks (digest),
    PRIMARY KEY (bake, digest)
);

CREATE INDEX bake_chunks_by_digest ON bake_chunks (digest);

CREATE INDEX bakes_by_end ON bakes (finished_ms) WHERE finished_ms IS NOT NULL;

-- What was stored before has generation 0; the lengths of scenes are not known here: they are found when asked for.
INSERT INTO chunks (digest, generation, bytes, used_ms)
    SELECT o.value ->> 'digest', 0, max((o.value ->> 'bytes')::bigint), 0
    FROM results r, jsonb_array_elements(r.outputs::jsonb) AS o (value) GROUP BY 1;
INSERT INTO chunks (digest, generation, bytes, used_ms)
    SELECT DISTINCT scene, NULL::bigint, 0, 0 FROM bakes ON CONFLICT DO NOTHING;

CREATE FUNCTION count_reference() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF TG_OP = 'INSERT' THEN
        UPDATE chunks SET refs = refs + 1 WHERE digest = NEW.digest;
    ELSE
        UPDATE chunks SET refs = refs - 1 WHERE digest = OLD.digest;
    END IF;
    RETURN NULL;
END
$$;

CREATE TRIGGER result_chunks_counted AFTER INSERT OR DELETE ON result_chunks
    FOR EACH ROW EXECUTE FUNCTION count_reference();
CREATE TRIGGER bake_chunks_counted AFTER INSERT OR DELETE ON bake_chunks
    FOR EACH ROW EXECUTE FUNCTION count_reference();

INSERT INTO storage_usage SELECT 1, count(generation), coalesce(sum(bytes), 0) FROM chunks;
INSERT INTO result_chunks SELECT DISTINCT r.task, o.value ->> 'digest'
    FROM results r, jsonb_array_elements(r.outputs::jsonb) AS o (value);
INSERT INTO bake_chunks SELECT seq, scene FROM bakes;
