-- Evaluations of bakes: the digest of an index, and the chunks that it takes. A table of its own, so that a file which a task of the bake
-- names too stays when the evaluation is replaced.

ALTER TABLE bakes ADD COLUMN evaluation TEXT;

CREATE TABLE evaluation_chunks (
    bake   INTEGER NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    digest TEXT NOT NULL REFERENCES chunks (digest),
    PRIMARY KEY (bake, digest)
) STRICT, WITHOUT ROWID;

CREATE INDEX evaluation_chunks_by_digest ON evaluation_chunks (digest);

CREATE TRIGGER evaluation_chunks_come AFTER INSERT ON evaluation_chunks BEGIN
    UPDATE chunks SET refs = refs + 1 WHERE digest = NEW.digest;
END;
CREATE TRIGGER evaluation_chunks_go AFTER DELETE ON evaluation_chunks BEGIN
    UPDATE chunks SET refs = refs - 1 WHERE digest = OLD.digest;
END;
