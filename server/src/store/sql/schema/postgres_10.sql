-- Lists of bakes in some states, and of those since a time.

CREATE INDEX bakes_by_state ON bakes (state, seq);
CREATE INDEX bakes_by_age ON bakes (created_ms);
