-- Those who have tokens. Rows stay when they are revoked: a farm that once asked for tokens goes on asking.

CREATE TABLE bearers (
    name       TEXT COLLATE "C" PRIMARY KEY,
    hash       TEXT NOT NULL UNIQUE,                             -- of the token, which is stored nowhere
    scopes     TEXT NOT NULL,
    created_ms BIGINT NOT NULL,
    revoked_ms BIGINT
);
