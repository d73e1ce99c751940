-- Ready tasks of one kind, in the order of claims: who looks for work asks for these, and does not pass those of other kinds.

CREATE INDEX ready_by_kind ON ready (bake, kind, cost DESC, key);
-- Those that have been waiting longest first.
CREATE INDEX ready_by_age ON ready (bake, kind, max(not_before_ms, since_ms));

-- Counts of tasks and of ready rows, kept with each change.
CREATE TABLE task_counts (
    kind  TEXT NOT NULL,
    state TEXT NOT NULL,
    count INTEGER NOT NULL,
    PRIMARY KEY (kind, state)
) STRICT, WITHOUT ROWID;

CREATE TABLE ready_counts (
    bake  INTEGER NOT NULL,
    kind  TEXT NOT NULL,
    count INTEGER NOT NULL,
    PRIMARY KEY (bake, kind)
) STRICT, WITHOUT ROWID;

INSERT INTO task_counts (kind, state, count) SELECT kind, state, count(*) FROM tasks GROUP BY kind, state;
INSERT INTO ready_counts (bake, kind, count) SELECT bake, kind, count(*) FROM ready GROUP BY bake, kind;
DROP INDEX tasks_by_state;

CREATE TRIGGER tasks_counted_in AFTER INSERT ON tasks BEGIN
    INSERT INTO task_counts (kind, state, count) VALUES (NEW.kind, NEW.state, 1)
        ON CONFLICT (kind, state) DO UPDATE SET count = count + 1;
END;
CREATE TRIGGER tasks_counted_out AFTER DELETE ON tasks BEGIN
    UPDATE task_counts SET count = count - 1 WHERE kind = OLD.kind AND state = OLD.state;
END;
CREATE TRIGGER tasks_counted_anew AFTER UPDATE OF state ON tasks WHEN OLD.state <> NEW.state BEGIN
    UPDATE task_counts SET count = count - 1 WHERE kind = OLD.kind AND state = OLD.state;
    INSERT INTO task_counts (kind, state, count) VALUES (NEW.kind, NEW.state, 1)
        ON CONFLICT (kind, state) DO UPDATE SET count = count + 1;
END;
CREATE TRIGGER ready_counted_in AFTER INSERT ON ready BEGIN
    INSERT INTO ready_counts (bake, kind, count) VALUES (NEW.bake, NEW.kind, 1)
        ON CONFLICT (bake, kind) DO UPDATE SET count = count + 1;
END;
-- A bake's count goes with its last ready row: bakes end, and are deleted.
CREATE TRIGGER ready_counted_out AFTER DELETE ON ready BEGIN
    UPDATE ready_counts SET count = count - 1 WHERE bake = OLD.bake AND kind = OLD.kind;
    DELETE FROM ready_counts WHERE bake = OLD.bake AND kind = OLD.kind AND count = 0;
END;
