-- How new the measurements are on which the gate last found a revision fit to be served, RFC 3339. It is the end of the
-- window until the revision holds its ground against a fit of newer measurements; NULL says that it has not.
ALTER TABLE revisions ADD COLUMN measured_to TEXT;
