-- Batches of diagnoses, beside those of estimates. As before, loosening a CHECK changes the text of the schema alone.
PRAGMA writable_schema = ON;
UPDATE sqlite_schema
SET sql = replace(sql, 'CHECK (kind IN (''recalibrate''))', 'CHECK (kind IN (''recalibrate'', ''diagnose''))')
WHERE type = 'table' AND name = 'batches';
PRAGMA writable_schema = RESET;
