-- How much has been heard of a lease's holder. It stood in `progress` before: -1 for granted, -2 for late.
ALTER TABLE leases ADD COLUMN state TEXT NOT NULL DEFAULT 'granted' CHECK (state IN ('granted', 'held', 'late'));
UPDATE leases SET state = CASE progress WHEN -1 THEN 'granted' WHEN -2 THEN 'late' ELSE 'held' END;
UPDATE leases SET progress = 0 WHERE progress < 0;
