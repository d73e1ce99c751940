-- The version of a task's code, which its key depends on; 0 for tasks from before it was told.
ALTER TABLE tasks ADD COLUMN version BIGINT NOT NULL DEFAULT 0;

-- The bearer that submitted a bake; NULL where nobody needed a token.
ALTER TABLE bakes ADD COLUMN owner TEXT;

-- The worker that gave a result.
ALTER TABLE results ADD COLUMN worker TEXT NOT NULL DEFAULT '';

-- Outputs of attempts whose leases were gone, until the task is done: its result must have the same.
CREATE TABLE witnesses (
    token   TEXT PRIMARY KEY,
    task    BIGINT NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    worker  TEXT NOT NULL,
    outputs TEXT NOT NULL
);

CREATE INDEX witnesses_by_task ON witnesses (task);

-- Results of one task that differ: by the token of the one that came later. Rows stay for good.
CREATE TABLE alarms (
    token  TEXT PRIMARY KEY,
    key    TEXT NOT NULL,                                        -- of the task
    kind   TEXT NOT NULL,
    worker TEXT NOT NULL,                                        -- that gave the other result
    output TEXT NOT NULL,
    kept   TEXT,
    found  TEXT,
    at_ms  BIGINT NOT NULL
);

ALTER TABLE bakes ADD COLUMN alarms BIGINT NOT NULL DEFAULT 0;
