-- What a task gave before its result was forgotten, until it gives it again: JSON as in results, or NULL.
ALTER TABLE tasks ADD COLUMN outputs_before TEXT;

-- Whether something that the attempt reads was forgotten while it was under way.
ALTER TABLE leases ADD COLUMN input_lost INTEGER NOT NULL DEFAULT 0;
