-- The share of a bake's results that are made once more on another machine, and the machine of a worker, empty where unknown.
ALTER TABLE bakes ADD COLUMN verify_share REAL NOT NULL DEFAULT 0;
ALTER TABLE workers ADD COLUMN machine TEXT NOT NULL DEFAULT '';

-- Results that are to be made once more. A row goes with the result that it verifies, and with its bake, which keeps what the task reads.
CREATE TABLE reruns (
    task        INTEGER PRIMARY KEY REFERENCES results (task) ON DELETE CASCADE,
    key         TEXT NOT NULL,
    bake        INTEGER NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    source      TEXT NOT NULL,                                   -- kind, needs, worker and machine: whoever may take one may take all
    until_ms    INTEGER NOT NULL,                                -- then it lapses
    is_paused   INTEGER NOT NULL,                                -- as its bake is
    tries       INTEGER NOT NULL DEFAULT 0,                      -- that failed
    token       TEXT,                                            -- of the lease under way, if there is one
    worker      TEXT,
    ttl_ms      INTEGER NOT NULL DEFAULT 0,
    started_ms  INTEGER NOT NULL DEFAULT 0,
    expires_ms  INTEGER NOT NULL DEFAULT 0,
    deadline_ms INTEGER NOT NULL DEFAULT 0,
    graces      INTEGER NOT NULL DEFAULT 0
) STRICT;

CREATE UNIQUE INDEX reruns_by_token ON reruns (token) WHERE token IS NOT NULL;
CREATE INDEX reruns_that_wait ON reruns (source, until_ms, key) WHERE token IS NULL AND is_paused = 0;
-- For those alone who ask what lapses: others might walk it past rows that are not theirs.
CREATE INDEX reruns_by_end ON reruns (until_ms) WHERE token IS NULL AND until_ms > 0;
CREATE INDEX reruns_by_expiry ON reruns (expires_ms) WHERE token IS NOT NULL;
CREATE INDEX reruns_by_bake ON reruns (bake);

-- Reruns that are over, however they ended, and results that were compared.
ALTER TABLE farm_totals ADD COLUMN reruns_over INTEGER NOT NULL DEFAULT 0;
ALTER TABLE farm_totals ADD COLUMN verified INTEGER NOT NULL DEFAULT 0;

CREATE TRIGGER reruns_counted_out AFTER DELETE ON reruns BEGIN
    UPDATE farm_totals SET reruns_over = reruns_over + 1;
END;
