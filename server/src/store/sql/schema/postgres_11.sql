-- Tasks that have a name in common: a lease tells of the results of those that are done.

ALTER TABLE tasks ADD COLUMN alike TEXT;
CREATE INDEX tasks_by_alike ON tasks (alike, id) WHERE alike IS NOT NULL;
