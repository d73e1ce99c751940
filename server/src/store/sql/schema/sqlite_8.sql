-- How often the lease was given its whole length again since its worker was last heard.
ALTER TABLE leases ADD COLUMN graces INTEGER NOT NULL DEFAULT 0;
