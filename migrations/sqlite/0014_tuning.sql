-- Jobs that choose settings of the search for a system. They have an outcome and no fit; what they found is a document of
-- theirs. The settings themselves stand in the document of the system. As before, loosening a CHECK changes the text of the
-- schema alone.
PRAGMA writable_schema = ON;
UPDATE sqlite_schema
SET sql = replace(replace(replace(sql,
    'CHECK (kind IN (''estimate'', ''diagnose'', ''ladder''))',
    'CHECK (kind IN (''estimate'', ''diagnose'', ''ladder'', ''tune''))'),
    'CHECK ((state = ''succeeded'' AND kind = ''estimate'') = (outcome IS NOT NULL))',
    'CHECK ((state = ''succeeded'' AND kind IN (''estimate'', ''tune'')) = (outcome IS NOT NULL))'),
    'CHECK ((state = ''succeeded'') = (fit IS NOT NULL))',
    'CHECK ((state = ''succeeded'' AND kind <> ''tune'') = (fit IS NOT NULL))')
WHERE type = 'table' AND name = 'jobs';
PRAGMA writable_schema = RESET;

ALTER TABLE jobs ADD COLUMN tuning TEXT;
