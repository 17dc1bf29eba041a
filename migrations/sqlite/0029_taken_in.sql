-- What earlier programs kept by channel is in `days` and `shares` by now.
DROP INDEX blocks_to_take_in;
DROP TABLE channel_days;
DROP TABLE window_blocks;
