-- Results of a bake in the order in which they landed: those that were there before take the order of their tasks. A place is
-- never given twice within a bake.

ALTER TABLE bakes ADD COLUMN last_place BIGINT NOT NULL DEFAULT 0;
ALTER TABLE bake_tasks ADD COLUMN place BIGINT;

UPDATE bake_tasks SET place = landed.place
FROM (SELECT bake, task, row_number() OVER (PARTITION BY bake ORDER BY task) AS place
      FROM bake_tasks WHERE done = 1) AS landed
WHERE landed.bake = bake_tasks.bake AND landed.task = bake_tasks.task;
UPDATE bakes SET last_place = (SELECT count(*) FROM bake_tasks m WHERE m.bake = bakes.seq AND m.done = 1);

CREATE UNIQUE INDEX bake_tasks_by_place ON bake_tasks (bake, place) WHERE place IS NOT NULL;

-- Cost that a task is claimed by, where that is not its own: it waited for a costlier one.

ALTER TABLE tasks ADD COLUMN claim_cost BIGINT;
