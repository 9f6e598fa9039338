//! Numbers as they are typed.

/// A positive number with an optional k, M or G.
pub fn count(text: &str) -> Result<u64, String> {
    let (digits, unit) = match text.chars().last() {
        Some('k' | 'K') => (&text[..text.len() - 1], 1_000),
        Some('M') => (&text[..text.len() - 1], 1_000_000),
        Some('G') => (&text[..text.len() - 1], 1_000_000_000),
        _ => (text, 1),
    };
    match digits.parse::<u64>().ok().and_then(|n| n.checked_mul(unit)) {
        Some(n @ 1..) => Ok(n),
        _ => Err(format!("{text:?} is no positive number such as 1000, 60k or 1M")),
    }
}
