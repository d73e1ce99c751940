-- The farm's state, version 1. Keys and digests are 64 hex digits, times Unix milliseconds, lists and maps JSON as text
-- (so that numbers keep their digits). Everything lies in the connection's first schema.

-- Statements take lists as JSON; SQLite has this function, so both read the same text.
CREATE FUNCTION json_each(list TEXT) RETURNS TABLE (key BIGINT, value TEXT)
LANGUAGE sql IMMUTABLE AS $$
    SELECT element.ordinality - 1, element.value
    FROM jsonb_array_elements_text(list::jsonb) WITH ORDINALITY AS element (value, ordinality)
$$;

-- Locked, never filled: EXCLUSIVE by calls that change bakes, ROW SHARE by claims and heartbeats.
CREATE TABLE turnstile ();

CREATE TABLE bakes (
    seq             BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    id              TEXT NOT NULL UNIQUE,
    idempotency_key TEXT UNIQUE,
    body_hash       TEXT NOT NULL,
    name            TEXT NOT NULL,
    kind            TEXT NOT NULL,
    scene           TEXT NOT NULL,
    settings        TEXT NOT NULL,
    priority        BIGINT NOT NULL,
    state           TEXT NOT NULL CHECK (state IN ('running', 'paused', 'done', 'failed', 'cancelled')),
    open_count      BIGINT NOT NULL CHECK (open_count >= 0),     -- tasks that are not done
    tasks_run       BIGINT NOT NULL,
    tasks_reused    BIGINT NOT NULL,
    counters        TEXT NOT NULL,
    counters_reused TEXT NOT NULL,
    manifest        TEXT,
    report          TEXT,
    failure         TEXT,
    created_ms      BIGINT NOT NULL,
    finished_ms     BIGINT,
    last_event      BIGINT NOT NULL                              -- seq of the newest event
) WITH (fillfactor = 50);

CREATE INDEX bakes_in_claim_order ON bakes (priority DESC, seq) WHERE state = 'running';

-- One row per key, whichever bakes want it.
CREATE TABLE tasks (
    id            BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    key           TEXT COLLATE "C" NOT NULL UNIQUE,
    kind          TEXT NOT NULL,
    label         TEXT COLLATE "C" NOT NULL,
    params        TEXT NOT NULL,
    inputs        TEXT NOT NULL,
    cost          BIGINT NOT NULL,
    state         TEXT NOT NULL CHECK (state IN ('waiting', 'ready', 'leased', 'done')),
    waiting_count BIGINT NOT NULL CHECK (waiting_count >= 0),    -- dependencies that are not done
    attempts      BIGINT NOT NULL DEFAULT 0,                     -- ended by a fault of a worker
    not_before_ms BIGINT NOT NULL DEFAULT 0
) WITH (fillfactor = 80);

CREATE INDEX tasks_by_state ON tasks (kind, state);

CREATE TABLE results (
    task     BIGINT PRIMARY KEY REFERENCES tasks (id) ON DELETE CASCADE,
    token    TEXT NOT NULL UNIQUE,                               -- of the attempt that committed it
    outputs  TEXT NOT NULL,
    plan     TEXT NOT NULL,
    counters TEXT NOT NULL
);

CREATE TABLE task_needs (
    task  BIGINT NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    needs BIGINT NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    PRIMARY KEY (task, needs)
);

CREATE INDEX task_needs_by_needs ON task_needs (needs, task);

-- Workers that failed at a task.
CREATE TABLE blames (
    task   BIGINT NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    worker TEXT NOT NULL,
    PRIMARY KEY (task, worker)
);

-- Which bakes hold which tasks; done and reused are 0 or 1.
CREATE TABLE bake_tasks (
    bake   BIGINT NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    task   BIGINT NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    done   BIGINT NOT NULL,
    reused BIGINT NOT NULL,
    PRIMARY KEY (bake, task)
);

CREATE INDEX bake_tasks_by_task ON bake_tasks (task, bake);

-- Ready tasks of live bakes, in claim order within each bake.
CREATE TABLE ready (
    bake          BIGINT NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    cost          BIGINT NOT NULL,
    key           TEXT COLLATE "C" NOT NULL,
    task          BIGINT NOT NULL REFERENCES tasks (id) ON DELETE CASCADE,
    kind          TEXT NOT NULL,
    not_before_ms BIGINT NOT NULL
);

CREATE UNIQUE INDEX ready_in_claim_order ON ready (bake, cost DESC, key);
CREATE INDEX ready_by_task ON ready (task);

-- A lease whose task was dropped (NULL) stays until it runs out, so that its holder can be told to stop.
CREATE TABLE leases (
    token      TEXT PRIMARY KEY,
    task       BIGINT UNIQUE REFERENCES tasks (id) ON DELETE SET NULL,
    worker     TEXT NOT NULL,
    ttl_ms     BIGINT NOT NULL,
    expires_ms BIGINT NOT NULL,
    progress   DOUBLE PRECISION NOT NULL
) WITH (fillfactor = 50);

CREATE INDEX leases_by_expiry ON leases (expires_ms);
CREATE INDEX leases_by_worker ON leases (worker);

-- Progress per bake and task kind, kept up to date with every change.
CREATE TABLE stages (
    bake           BIGINT NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    kind           TEXT COLLATE "C" NOT NULL,
    position       BIGINT NOT NULL,                              -- order of first appearance
    total          BIGINT NOT NULL DEFAULT 0,
    done           BIGINT NOT NULL DEFAULT 0,
    reused         BIGINT NOT NULL DEFAULT 0,
    leased         BIGINT NOT NULL DEFAULT 0 CHECK (leased >= 0),
    cost_total     BIGINT NOT NULL DEFAULT 0,
    cost_done      BIGINT NOT NULL DEFAULT 0,
    first_claim_ms BIGINT,
    last_commit_ms BIGINT,
    PRIMARY KEY (bake, kind)
) WITH (fillfactor = 50);

CREATE TABLE events (
    bake  BIGINT NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    seq   BIGINT NOT NULL,
    at_ms BIGINT NOT NULL,
    event TEXT NOT NULL,
    PRIMARY KEY (bake, seq)
);

CREATE TABLE workers (
    name    TEXT COLLATE "C" PRIMARY KEY,
    kinds   TEXT NOT NULL,
    threads BIGINT NOT NULL,
    seen_ms BIGINT NOT NULL
) WITH (fillfactor = 50);

-- One row that is written to show that writing works.
CREATE TABLE probe (
    id    BIGINT PRIMARY KEY CHECK (id = 1),
    at_ms BIGINT NOT NULL
);
