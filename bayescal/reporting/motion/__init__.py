"""Reports of joint logs: record, words, terminal."""
