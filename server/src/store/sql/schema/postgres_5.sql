-- Results that bakes lost after their end: bytes were lost, and no live bake wanted the task. Whoever runs it again gives
-- it back to them.

CREATE TABLE lost_results (
    key  TEXT COLLATE "C" NOT NULL,                              -- of the task
    bake BIGINT NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    PRIMARY KEY (key, bake)
);

CREATE INDEX lost_results_by_bake ON lost_results (bake);

-- Since when a task could have been claimed: for how long it has been waiting for a worker.
ALTER TABLE ready ADD COLUMN since_ms BIGINT NOT NULL DEFAULT 0;
UPDATE ready SET since_ms = CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT);

-- What bakes that are deleted, and results that are forgotten, take out of the sums over bakes: those never fall.
CREATE TABLE farm_totals (
    id           BIGINT PRIMARY KEY CHECK (id = 1),
    tasks_run    BIGINT NOT NULL,
    tasks_reused BIGINT NOT NULL
) WITH (fillfactor = 10);

INSERT INTO farm_totals VALUES (1, 0, 0);

-- When an attempt began.
ALTER TABLE leases ADD COLUMN started_ms BIGINT NOT NULL DEFAULT 0;
UPDATE leases SET started_ms = expires_ms - ttl_ms;

-- The trace that the submission belongs to, as W3C Trace Context writes it.
ALTER TABLE bakes ADD COLUMN traceparent TEXT;
