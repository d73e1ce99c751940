-- Evaluations of bakes: the digest of an index, and the chunks that it takes. A table of its own, so that a file which a task of the bake
-- names too stays when the evaluation is replaced.

ALTER TABLE bakes ADD COLUMN evaluation TEXT;

CREATE TABLE evaluation_chunks (
    bake   BIGINT NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    digest TEXT COLLATE "C" NOT NULL REFERENCES chunks (digest),
    PRIMARY KEY (bake, digest)
);

CREATE INDEX evaluation_chunks_by_digest ON evaluation_chunks (digest);

CREATE TRIGGER evaluation_chunks_counted AFTER INSERT OR DELETE ON evaluation_chunks
    FOR EACH ROW EXECUTE FUNCTION count_reference();
