//! Memory that is used again.

/// The first `length` numbers of memory that only ever grows: shrinking and growing again would fill it with zeros each
/// time. What they hold is left over from earlier uses.
pub fn at_least(memory: &mut Vec<f32>, length: usize) -> &mut [f32] {
    if memory.len() < length {
        // Not copied along: nobody wants the old numbers.
        memory.clear();
        memory.resize(length, 0.0);
    }
    &mut memory[..length]
}
