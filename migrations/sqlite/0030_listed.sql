-- What lists read of a fit and of a diagnosis, beside their documents.

-- Errors by output, the parts of the window and where the fit fails most; NULL in rows of earlier programs until the
-- program has filled it in.
ALTER TABLE fits ADD COLUMN listed TEXT;
-- The validation error of the first output, where it tells how a system fares over time: not of experiments, of what a
-- diagnosis needed, nor of what kept a test part aside.
ALTER TABLE fits ADD COLUMN validation_rmse REAL;
CREATE INDEX fits_in_trend ON fits (system, model, validation_rmse) WHERE validation_rmse IS NOT NULL;
CREATE INDEX fits_to_list ON fits (created_at) WHERE listed IS NULL;

-- The first effect that a diagnosis has named: {effect, title, size}.
ALTER TABLE diagnoses ADD COLUMN missing TEXT;
UPDATE diagnoses SET missing = json_object(
    'effect', json_extract(document, '$.findings[0].effect'),
    'title', json_extract(document, '$.findings[0].title'),
    'size', json_extract(document, '$.findings[0].size')
) WHERE verdict = 'named';
