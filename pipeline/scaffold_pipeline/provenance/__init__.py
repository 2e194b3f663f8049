"""What a run came from: verified again, compared with another, packed as an RO-Crate."""
