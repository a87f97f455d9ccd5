//! What a path holds, and which convention its numbers follow.
