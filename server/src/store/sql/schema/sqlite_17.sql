-- Limits of single bakes. A lease tells which bake its task was handed out for: that one's workers are counted.
ALTER TABLE bakes ADD COLUMN max_workers INTEGER;
ALTER TABLE bakes ADD COLUMN max_attempts INTEGER;
ALTER TABLE bakes ADD COLUMN max_lost INTEGER;
ALTER TABLE leases ADD COLUMN bake INTEGER;
CREATE INDEX leases_by_bake ON leases (bake, worker);
