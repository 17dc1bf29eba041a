-- Which windows a fit has seen: those that gave a sample to the stitched input whose hash the fit stores. They are
-- cited even where they belong to a neighbour. A window that is cited cannot be deleted: the key refuses it.
CREATE TABLE fit_windows (
    fit    TEXT NOT NULL REFERENCES fits (id) ON DELETE CASCADE,
    window TEXT NOT NULL REFERENCES windows (id),
    PRIMARY KEY (fit, window)
) WITHOUT ROWID;
CREATE INDEX fits_of_window ON fit_windows (window);

-- Earlier fits did not note it. They cite every window, of their system and of its neighbours, that was there when
-- they were made and touches the time that they cover: perhaps more than they saw, never less.
INSERT INTO fit_windows (fit, window)
SELECT f.id, w.id
FROM fits f
JOIN systems s ON s.system = f.system
JOIN windows w ON w.system = f.system OR w.system IN (SELECT value FROM json_each(s.document, '$.neighbours'))
WHERE w.uploaded_at <= f.created_at
  AND w.to_s >= unixepoch(f.document ->> '$.parts.train.from')
  AND w.from_s <= unixepoch(COALESCE(f.document ->> '$.parts.test.to', f.document ->> '$.parts.validation.to', f.document ->> '$.parts.train.to'));
