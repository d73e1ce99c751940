-- Workers that were lost with a task are counted apart from those that failed at it: machines go, and the task is not to blame.
ALTER TABLE tasks ADD COLUMN losses BIGINT NOT NULL DEFAULT 0;

CREATE TABLE losses (
    task   BIGINT NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    worker TEXT NOT NULL,
    PRIMARY KEY (task, worker)
);

-- Leases that ran out. `counted` until the holder turns out to be alive; `is_first`: the worker had not been lost with the task before.
ALTER TABLE expired RENAME COLUMN has_blamed TO is_first;
ALTER TABLE expired ADD COLUMN counted BIGINT NOT NULL DEFAULT 1;

UPDATE tasks SET losses = (SELECT count(*) FROM expired e WHERE e.task = tasks.id)
WHERE id IN (SELECT task FROM expired);
UPDATE tasks SET attempts = CASE WHEN attempts > losses THEN attempts - losses ELSE 0 END WHERE losses > 0;
INSERT INTO losses (task, worker) SELECT DISTINCT task, worker FROM expired;
DELETE FROM blames WHERE EXISTS (SELECT 1 FROM expired e
                                 WHERE e.task = blames.task AND e.worker = blames.worker AND e.is_first = 1);

-- Attempts of a bake's tasks that failed, and those whose workers were lost.
ALTER TABLE bakes ADD COLUMN attempts_failed BIGINT NOT NULL DEFAULT 0;
ALTER TABLE bakes ADD COLUMN attempts_lost BIGINT NOT NULL DEFAULT 0;

-- Waits of tasks that are tried again.
CREATE INDEX ready_by_wait ON ready (not_before_ms) WHERE not_before_ms > 0;
