-- Servers of the former version go on meanwhile: their changes and claims wait here.
LOCK TABLE turnstile IN ACCESS EXCLUSIVE MODE;

-- Long plans, and tasks with many inputs, are compressed fast where this PostgreSQL was built with lz4: its own way takes a second for
-- a hundred thousand tasks.
DO $$
BEGIN
    ALTER TABLE results ALTER COLUMN plan SET COMPRESSION lz4;
    ALTER TABLE tasks ALTER COLUMN inputs SET COMPRESSION lz4, ALTER COLUMN params SET COMPRESSION lz4;
EXCEPTION WHEN feature_not_supported THEN NULL;
END
$$;
