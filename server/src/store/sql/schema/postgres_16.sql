-- Many servers at one database: statements whose cost does not grow with the tables, counts that are kept, and rows that
-- are taken in fast.

-- Servers of the former version go on meanwhile: their changes and claims wait here, and find nothing that they know missing. Their claims
-- take longer until they are stopped, as they read the index that goes.
LOCK TABLE turnstile IN ACCESS EXCLUSIVE MODE;

-- Ready tasks of one kind of a bake: in claim order, and those that have been waiting longest first. The bake comes second there: who walks
-- a bake's ready tasks in the order of claims cannot take that index, and sort all of them, by mistake.
DROP INDEX ready_in_claim_order;
CREATE UNIQUE INDEX ready_in_claim_order ON ready (bake, kind, cost DESC, key);
CREATE INDEX ready_by_kind ON ready (kind, bake, (greatest(not_before_ms, since_ms)));

-- Foreign keys cost two look-ups for each row of a plan. These rows are written by statements that read both sides, and
-- go with their tasks and bakes by the triggers below.
ALTER TABLE bake_tasks DROP CONSTRAINT bake_tasks_bake_fkey, DROP CONSTRAINT bake_tasks_task_fkey;
ALTER TABLE ready DROP CONSTRAINT ready_bake_fkey, DROP CONSTRAINT ready_task_fkey;
ALTER TABLE task_needs DROP CONSTRAINT task_needs_task_fkey, DROP CONSTRAINT task_needs_needs_fkey;
-- These cost four look-ups for each task that a cancelled bake drops.
ALTER TABLE results DROP CONSTRAINT results_task_fkey;
ALTER TABLE blames DROP CONSTRAINT blames_task_fkey;
ALTER TABLE expired DROP CONSTRAINT expired_task_fkey;
ALTER TABLE losses DROP CONSTRAINT losses_task_fkey;
ALTER TABLE witnesses DROP CONSTRAINT witnesses_task_fkey;
ALTER TABLE leases DROP CONSTRAINT leases_task_fkey;

CREATE FUNCTION drop_rows_of_tasks() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM ready r USING gone g WHERE r.task = g.id;
    DELETE FROM task_needs n USING gone g WHERE n.task = g.id;
    DELETE FROM task_needs n USING gone g WHERE n.needs = g.id;
    DELETE FROM bake_tasks m USING gone g WHERE m.task = g.id;
    DELETE FROM results r USING gone g WHERE r.task = g.id;
    DELETE FROM blames x USING gone g WHERE x.task = g.id;
    DELETE FROM losses x USING gone g WHERE x.task = g.id;
    DELETE FROM witnesses x USING gone g WHERE x.task = g.id;
    DELETE FROM expired x USING gone g WHERE x.task = g.id;
    UPDATE leases l SET task = NULL FROM gone g WHERE l.task = g.id;
    RETURN NULL;
END
$$;

CREATE TRIGGER tasks_dropped AFTER DELETE ON tasks REFERENCING OLD TABLE AS gone
    FOR EACH STATEMENT EXECUTE FUNCTION drop_rows_of_tasks();

CREATE FUNCTION drop_rows_of_bakes() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM ready r USING gone g WHERE r.bake = g.seq;
    DELETE FROM bake_tasks m USING gone g WHERE m.bake = g.seq;
    RETURN NULL;
END
$$;

CREATE TRIGGER bakes_dropped AFTER DELETE ON bakes REFERENCING OLD TABLE AS gone
    FOR EACH STATEMENT EXECUTE FUNCTION drop_rows_of_bakes();

-- Counts of tasks and of ready rows, in parts: each session adds to its own, so that none waits for another. A count is the
-- sum over the slots; the collection of garbage puts the parts together under slot 0.
CREATE TABLE task_counts (
    slot  BIGINT NOT NULL,                                       -- process of the session
    kind  TEXT NOT NULL,
    state TEXT NOT NULL,
    count BIGINT NOT NULL,
    PRIMARY KEY (slot, kind, state)
) WITH (fillfactor = 50);

CREATE TABLE ready_counts (
    slot  BIGINT NOT NULL,
    bake  BIGINT NOT NULL,
    kind  TEXT NOT NULL,
    count BIGINT NOT NULL,
    PRIMARY KEY (slot, bake, kind)
) WITH (fillfactor = 50);

INSERT INTO task_counts (slot, kind, state, count) SELECT 0, kind, state, count(*) FROM tasks GROUP BY kind, state;
INSERT INTO ready_counts (slot, bake, kind, count) SELECT 0, bake, kind, count(*) FROM ready GROUP BY bake, kind;
DROP INDEX tasks_by_state;

CREATE FUNCTION count_tasks() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF TG_OP = 'INSERT' THEN
        INSERT INTO task_counts AS c (slot, kind, state, count)
            SELECT pg_backend_pid(), kind, state, count(*) FROM is_now GROUP BY kind, state
            ON CONFLICT (slot, kind, state) DO UPDATE SET count = c.count + excluded.count;
    ELSIF TG_OP = 'DELETE' THEN
        INSERT INTO task_counts AS c (slot, kind, state, count)
            SELECT pg_backend_pid(), kind, state, -count(*) FROM was GROUP BY kind, state
            ON CONFLICT (slot, kind, state) DO UPDATE SET count = c.count + excluded.count;
    ELSE
        INSERT INTO task_counts AS c (slot, kind, state, count)
            SELECT pg_backend_pid(), kind, state, sum(change)
            FROM (SELECT kind, state, -1 AS change FROM was UNION ALL SELECT kind, state, 1 FROM is_now) AS changes
            GROUP BY kind, state HAVING sum(change) <> 0
            ON CONFLICT (slot, kind, state) DO UPDATE SET count = c.count + excluded.count;
    END IF;
    RETURN NULL;
END
$$;

CREATE TRIGGER tasks_counted_in AFTER INSERT ON tasks REFERENCING NEW TABLE AS is_now
    FOR EACH STATEMENT EXECUTE FUNCTION count_tasks();
CREATE TRIGGER tasks_counted_out AFTER DELETE ON tasks REFERENCING OLD TABLE AS was
    FOR EACH STATEMENT EXECUTE FUNCTION count_tasks();
CREATE TRIGGER tasks_counted_anew AFTER UPDATE ON tasks REFERENCING OLD TABLE AS was NEW TABLE AS is_now
    FOR EACH STATEMENT EXECUTE FUNCTION count_tasks();

CREATE FUNCTION count_ready() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO ready_counts AS c (slot, bake, kind, count)
        SELECT pg_backend_pid(), bake, kind, CASE TG_OP WHEN 'INSERT' THEN count(*) ELSE -count(*) END
        FROM changed GROUP BY bake, kind
        ON CONFLICT (slot, bake, kind) DO UPDATE SET count = c.count + excluded.count;
    RETURN NULL;
END
$$;

CREATE TRIGGER ready_counted_in AFTER INSERT ON ready REFERENCING NEW TABLE AS changed
    FOR EACH STATEMENT EXECUTE FUNCTION count_ready();
CREATE TRIGGER ready_counted_out AFTER DELETE ON ready REFERENCING OLD TABLE AS changed
    FOR EACH STATEMENT EXECUTE FUNCTION count_ready();

-- References to chunks are counted for a statement at once, and their rows locked in one order: two that share chunks never
-- wait for each other in a ring.
DROP TRIGGER result_chunks_counted ON result_chunks;
DROP TRIGGER bake_chunks_counted ON bake_chunks;
DROP TRIGGER evaluation_chunks_counted ON evaluation_chunks;
DROP FUNCTION count_reference();

CREATE FUNCTION count_references() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM 1 FROM chunks c WHERE c.digest IN (SELECT digest FROM changed) ORDER BY c.digest FOR NO KEY UPDATE;
    UPDATE chunks SET refs = refs + CASE TG_OP WHEN 'INSERT' THEN n.times ELSE -n.times END
        FROM (SELECT digest, count(*) AS times FROM changed GROUP BY digest) AS n WHERE chunks.digest = n.digest;
    RETURN NULL;
END
$$;

CREATE TRIGGER result_chunks_counted_in AFTER INSERT ON result_chunks REFERENCING NEW TABLE AS changed
    FOR EACH STATEMENT EXECUTE FUNCTION count_references();
CREATE TRIGGER result_chunks_counted_out AFTER DELETE ON result_chunks REFERENCING OLD TABLE AS changed
    FOR EACH STATEMENT EXECUTE FUNCTION count_references();
CREATE TRIGGER bake_chunks_counted_in AFTER INSERT ON bake_chunks REFERENCING NEW TABLE AS changed
    FOR EACH STATEMENT EXECUTE FUNCTION count_references();
CREATE TRIGGER bake_chunks_counted_out AFTER DELETE ON bake_chunks REFERENCING OLD TABLE AS changed
    FOR EACH STATEMENT EXECUTE FUNCTION count_references();
CREATE TRIGGER evaluation_chunks_counted_in AFTER INSERT ON evaluation_chunks REFERENCING NEW TABLE AS changed
    FOR EACH STATEMENT EXECUTE FUNCTION count_references();
CREATE TRIGGER evaluation_chunks_counted_out AFTER DELETE ON evaluation_chunks REFERENCING OLD TABLE AS changed
    FOR EACH STATEMENT EXECUTE FUNCTION count_references();
