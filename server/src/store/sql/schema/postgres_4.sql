-- Who may take what, how long an attempt may take, and which scene a worker had last.

ALTER TABLE bakes ADD COLUMN needs TEXT NOT NULL DEFAULT '{}';
ALTER TABLE bakes ADD COLUMN attempt_limit_secs BIGINT;
ALTER TABLE leases ADD COLUMN deadline_ms BIGINT NOT NULL DEFAULT 9223372036854775807;
ALTER TABLE workers ADD COLUMN memory_mib BIGINT NOT NULL DEFAULT 0;
ALTER TABLE workers ADD COLUMN labels TEXT NOT NULL DEFAULT '[]';
ALTER TABLE workers ADD COLUMN scene TEXT;

CREATE INDEX blames_by_worker ON blames (worker, task);
