-- The farm's state, version 1. Keys and digests are 64 hex digits, times Unix milliseconds, lists and maps JSON.

CREATE TABLE bakes (
    seq             INTEGER PRIMARY KEY AUTOINCREMENT,
    id              TEXT NOT NULL UNIQUE,
    idempotency_key TEXT UNIQUE,
    body_hash       TEXT NOT NULL,
    name            TEXT NOT NULL,
    kind            TEXT NOT NULL,
    scene           TEXT NOT NULL,
    settings        TEXT NOT NULL,
    priority        INTEGER NOT NULL,
    state           TEXT NOT NULL CHECK (state IN ('running', 'paused', 'done', 'failed', 'cancelled')),
    open_count      INTEGER NOT NULL CHECK (open_count >= 0),    -- tasks that are not done
    tasks_run       INTEGER NOT NULL,
    tasks_reused    INTEGER NOT NULL,
    counters        TEXT NOT NULL,
    counters_reused TEXT NOT NULL,
    manifest        TEXT,
    report          TEXT,
    failure         TEXT,
    created_ms      INTEGER NOT NULL,
    finished_ms     INTEGER,
    last_event      INTEGER NOT NULL                             -- seq of the newest event
) STRICT;

CREATE INDEX bakes_in_claim_order ON bakes (priority DESC, seq) WHERE state = 'running';

-- One row per key, whichever bakes want it.
CREATE TABLE tasks (
    id            INTEGER PRIMARY KEY,
    key           TEXT NOT NULL UNIQUE,
    kind          TEXT NOT NULL,
    label         TEXT NOT NULL,
    params        TEXT NOT NULL,
    inputs        TEXT NOT NULL,
    cost          INTEGER NOT NULL,
    state         TEXT NOT NULL CHECK (state IN ('waiting', 'ready', 'leased', 'done')),
    waiting_count INTEGER NOT NULL CHECK (waiting_count >= 0),   -- dependencies that are not done
    attempts      INTEGER NOT NULL DEFAULT 0,                    -- ended by a fault of a worker
    not_before_ms INTEGER NOT NULL DEFAULT 0
) STRICT;

CREATE INDEX tasks_by_state ON tasks (kind, state);

CREATE TABLE results (
    task     INTEGER PRIMARY KEY REFERENCES tasks (id) ON DELETE CASCADE,
    token    TEXT NOT NULL UNIQUE,                               -- of the attempt that committed it
    outputs  TEXT NOT NULL,
    plan     TEXT NOT NULL,
    counters TEXT NOT NULL
) STRICT;

CREATE TABLE task_needs (
    task  INTEGER NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    needs INTEGER NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    PRIMARY KEY (task, needs)
) STRICT, WITHOUT ROWID;

CREATE INDEX task_needs_by_needs ON task_needs (needs, task);

-- Workers that failed at a task.
CREATE TABLE blames (
    task   INTEGER NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    worker TEXT NOT NULL,
    PRIMARY KEY (task, worker)
) STRICT, WITHOUT ROWID;

-- Which bakes hold which tasks.
CREATE TABLE bake_tasks (
    bake   INTEGER NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    task   INTEGER NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    done   INTEGER NOT NULL,
    reused INTEGER NOT NULL,
    PRIMARY KEY (bake, task)
) STRICT, WITHOUT ROWID;

CREATE INDEX bake_tasks_by_task ON bake_tasks (task, bake);

-- Ready tasks of live bakes, in claim order within each bake.
CREATE TABLE ready (
    bake          INTEGER NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    cost          INTEGER NOT NULL,
    key           TEXT NOT NULL,
    task          INTEGER NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    kind          TEXT NOT NULL,
    not_before_ms INTEGER NOT NULL,
    PRIMARY KEY (bake, cost DESC, key)
) STRICT, WITHOUT ROWID;

CREATE INDEX ready_by_task ON ready (task);

-- A lease whose task was dropped (NULL) stays until it runs out, so that its holder can be told to stop.
CREATE TABLE leases (
    token      TEXT PRIMARY KEY,
    task       INTEGER UNIQUE REFERENCES tasks (id) ON DELETE SET NULL,
    worker     TEXT NOT NULL,
    ttl_ms     INTEGER NOT NULL,
    expires_ms INTEGER NOT NULL,
    progress   REAL NOT NULL
) STRICT, WITHOUT ROWID;

CREATE INDEX leases_by_expiry ON leases (expires_ms);
CREATE INDEX leases_by_worker ON leases (worker);

-- Progress per bake and task kind, kept up to date with every change.
CREATE TABLE stages (
    bake           INTEGER NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    kind           TEXT NOT NULL,
    position       INTEGER NOT NULL,                             -- order of first appearance
    total          INTEGER NOT NULL DEFAULT 0,
    done           INTEGER NOT NULL DEFAULT 0,
    reused         INTEGER NOT NULL DEFAULT 0,
    leased         INTEGER NOT NULL DEFAULT 0 CHECK (leased >= 0),
    cost_total     INTEGER NOT NULL DEFAULT 0,
    cost_done      INTEGER NOT NULL DEFAULT 0,
    first_claim_ms INTEGER,
    last_commit_ms INTEGER,
    PRIMARY KEY (bake, kind)
) STRICT, WITHOUT ROWID;

CREATE TABLE events (
    bake  INTEGER NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    seq   INTEGER NOT NULL,
    at_ms INTEGER NOT NULL,
    event TEXT NOT NULL,
    PRIMARY KEY (bake, seq)
) STRICT, WITHOUT ROWID;

CREATE TABLE workers (
    name    TEXT PRIMARY KEY,
    kinds   TEXT NOT NULL,
    threads INTEGER NOT NULL,
    seen_ms INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- One row that is written to show that writing works.
CREATE TABLE probe (
    id    INTEGER PRIMARY KEY CHECK (id = 1),
    at_ms INTEGER NOT NULL
) STRICT;
