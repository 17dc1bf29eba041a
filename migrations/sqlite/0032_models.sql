-- Which models the systems have is counted without their documents.
CREATE INDEX systems_of_models ON systems (model, system);
