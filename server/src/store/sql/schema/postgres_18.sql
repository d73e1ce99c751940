-- Servers of the former version go on meanwhile: their changes and claims wait here. They choose no results, and end no reruns.
LOCK TABLE turnstile IN ACCESS EXCLUSIVE MODE;

-- The share of a bake's results that are made once more on another machine, and the machine of a worker, empty where unknown.
ALTER TABLE bakes ADD COLUMN verify_share DOUBLE PRECISION NOT NULL DEFAULT 0;
ALTER TABLE workers ADD COLUMN machine TEXT NOT NULL DEFAULT '';

-- Results that are to be made once more. A row goes with the result that it verifies, and with its bake, which keeps what the task reads.
CREATE TABLE reruns (
    task        BIGINT PRIMARY KEY,
    key         TEXT NOT NULL,
    bake        BIGINT NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    source      TEXT COLLATE "C" NOT NULL,                       -- kind, needs, worker and machine: whoever may take one may take all
    until_ms    BIGINT NOT NULL,                                 -- then it lapses
    is_paused   BIGINT NOT NULL,                                 -- as its bake is
    tries       BIGINT NOT NULL DEFAULT 0,                       -- that failed
    token       TEXT,                                            -- of the lease under way, if there is one
    worker      TEXT,
    ttl_ms      BIGINT NOT NULL DEFAULT 0,
    started_ms  BIGINT NOT NULL DEFAULT 0,
    expires_ms  BIGINT NOT NULL DEFAULT 0,
    deadline_ms BIGINT NOT NULL DEFAULT 0,
    graces      BIGINT NOT NULL DEFAULT 0
);

CREATE UNIQUE INDEX reruns_by_token ON reruns (token) WHERE token IS NOT NULL;
CREATE INDEX reruns_that_wait ON reruns (source, until_ms, key) WHERE token IS NULL AND is_paused = 0;
-- For those alone who ask what lapses: others might walk it past rows that are not theirs.
CREATE INDEX reruns_by_end ON reruns (until_ms) WHERE token IS NULL AND until_ms > 0;
CREATE INDEX reruns_by_expiry ON reruns (expires_ms) WHERE token IS NOT NULL;
CREATE INDEX reruns_by_bake ON reruns (bake);

-- Reruns that are over, however they ended, and results that were compared.
ALTER TABLE farm_totals ADD COLUMN reruns_over BIGINT NOT NULL DEFAULT 0;
ALTER TABLE farm_totals ADD COLUMN verified BIGINT NOT NULL DEFAULT 0;

CREATE FUNCTION drop_reruns_of_results() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM reruns r USING gone g WHERE r.task = g.task;
    RETURN NULL;
END
$$;

CREATE TRIGGER results_dropped AFTER DELETE ON results REFERENCING OLD TABLE AS gone
    FOR EACH STATEMENT EXECUTE FUNCTION drop_reruns_of_results();

CREATE FUNCTION count_reruns_over() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    UPDATE farm_totals SET reruns_over = reruns_over + n.times
        FROM (SELECT count(*) AS times FROM gone) AS n WHERE n.times > 0;
    RETURN NULL;
END
$$;

CREATE TRIGGER reruns_counted_out AFTER DELETE ON reruns REFERENCING OLD TABLE AS gone
    FOR EACH STATEMENT EXECUTE FUNCTION count_reruns_over();
