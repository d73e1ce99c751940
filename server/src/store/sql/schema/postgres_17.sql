-- Servers of the former version go on meanwhile: their changes and claims wait here.
LOCK TABLE turnstile IN ACCESS EXCLUSIVE MODE;

-- Limits of single bakes. A lease tells which bake its task was handed out for: that one's workers are counted.
ALTER TABLE bakes ADD COLUMN max_workers BIGINT;
ALTER TABLE bakes ADD COLUMN max_attempts BIGINT;
ALTER TABLE bakes ADD COLUMN max_lost BIGINT;
ALTER TABLE leases ADD COLUMN bake BIGINT;
CREATE INDEX leases_by_bake ON leases (bake, worker);
