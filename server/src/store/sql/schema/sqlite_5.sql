-- Results that bakes lost after their end: bytes were lost, and no live bake wanted the task. Whoever runs it again gives
-- it back to them.

CREATE TABLE lost_results (
    key  TEXT NOT NULL,                                          -- of the task
    bake INTEGER NOT NULL REFERENCES bakes (seq) ON DELETE CASCADE,
    PRIMARY KEY (key, bake)
) STRICT, WITHOUT ROWID;

CREATE INDEX lost_results_by_bake ON lost_results (bake);
