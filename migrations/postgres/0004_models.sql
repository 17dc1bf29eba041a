-- Which models the systems have, as `../sqlite/0032_models.sql` tells.
CREATE INDEX systems_of_models ON systems (model, system);
