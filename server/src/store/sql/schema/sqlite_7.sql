-- Attempts that were counted because their leases ran out: given back if their holders turn out to be alive.
CREATE TABLE expired (
    token      TEXT PRIMARY KEY,
    task       INTEGER NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    worker     TEXT NOT NULL,
    has_blamed INTEGER NOT NULL                                  -- 1: the worker had not failed at the task before
) STRICT, WITHOUT ROWID;

CREATE INDEX expired_by_task ON expired (task);

-- Attempts of a task that were given back, or not counted, because of that.
ALTER TABLE tasks ADD COLUMN pardons INTEGER NOT NULL DEFAULT 0;

-- Which attempt at its task a lease is.
ALTER TABLE leases ADD COLUMN attempt INTEGER NOT NULL DEFAULT 1;
UPDATE leases SET attempt = 1 + (SELECT t.attempts FROM tasks t WHERE t.id = leases.task) WHERE task IS NOT NULL;
