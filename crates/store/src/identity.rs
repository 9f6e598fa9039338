//! What a stage was made from: the inputs and flags that its results depend on, in words.
//!
//! Two runs with the same identity write the same results, so one may finish what the other began.

use std::fmt::Display;

use enf_layout::sections::Malformed;
use xxhash_rust::xxh3::xxh3_128;

/// An ordered list of keys and values, stored as text, one `key = value` a line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Identity(Vec<(String, String)>);

impl Identity {
    /// An empty identity.
    pub fn new() -> Self {
        Self::default()
    }

    /// Appends an input or flag. Order counts.
    pub fn push(&mut self, key: impl Into<String>, value: impl Display) -> &mut Self {
        self.0.push((key.into(), value.to_string()));
        self
    }

    /// The value of the first entry with this key.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|e| e.0 == key).map(|e| e.1.as_str())
    }

    /// The entries in order.
    pub fn entries(&self) -> &[(String, String)] {
        &self.0
    }

    /// XXH3-128 of the text, little-endian.
    pub fn hash(&self) -> [u8; 16] {
        xxh3_128(self.to_text().as_bytes()).to_le_bytes()
    }

    /// The stored form.
    pub fn to_text(&self) -> String {
        self.0
            .iter()
            .map(|(key, value)| format!("{} = {}\n", escape(key, true), escape(value, false)))
            .collect()
    }

    /// Reads the stored form.
    ///
    /// # Errors
    /// When a line is no `key = value`.
    pub fn from_text(text: &str) -> Result<Self, Malformed> {
        let entry = |line: &str| {
            line.split_once(" = ")
                .map(|(key, value)| (unescape(key), unescape(value)))
                .ok_or_else(|| Malformed(format!("an identity has the line '{line}'")))
        };
        text.split_terminator('\n').map(entry).collect::<Result<_, _>>().map(Self)
    }

    /// How `other`, found there, differs from this one, wanted here; one line each, such as
    /// `photons-per-light: 20000 there, 50000 here`. Empty only for equal identities.
    pub fn differences(&self, other: &Identity) -> Vec<String> {
        let mut list = Vec::new();
        let say = |value: Option<&str>| value.unwrap_or("nothing").to_string();
        for (key, here) in &self.0 {
            let there = other.get(key);
            if there != Some(here) && self.get(key) == Some(here) {
                list.push(format!("{key}: {} there, {here} here", say(there)));
            }
        }
        for (key, there) in &other.0 {
            if self.get(key).is_none() {
                list.push(format!("{key}: {there} there, nothing here"));
            }
        }
        if list.is_empty() && self != other {
            list.push("the same inputs and flags in another order".into());
        }
        list
    }
}

fn escape(text: &str, key: bool) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '=' if key => out.push_str("\\e"),
            c => out.push(c),
        }
    }
    out
}

fn unescape(text: &str) -> String {
    let (mut out, mut chars) = (String::with_capacity(text.len()), text.chars());
    while let Some(c) = chars.next() {
        match (c, c == '\\') {
            (_, true) => match chars.next() {
                Some('n') => out.push('\n'),
                Some('e') => out.push('='),
                Some(other) => out.push(other),
                None => out.push('\\'),
            },
            (c, _) => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(entries: &[(&str, &str)]) -> Identity {
        let mut identity = Identity::new();
        for (key, value) in entries {
            identity.push(*key, value);
        }
        identity
    }

    #[test]
    fn differences_say_who_has_what() {
        let here = of(&[("seed", "1"), ("photons-per-light", "50000"), ("sky", "clear")]);
        let there = of(&[("seed", "1"), ("photons-per-light", "20000"), ("sun", "noon")]);
        assert_eq!(
            here.differences(&there),
            [
                "photons-per-light: 20000 there, 50000 here",
                "sky: nothing there, clear here",
                "sun: noon there, nothing here"
            ]
        );
        assert!(here.differences(&here).is_empty());
    }

    #[test]
    fn garbage_is_no_identity() {
        assert!(Identity::from_text("seed 1\n").is_err());
        assert_eq!(Identity::from_text(""), Ok(Identity::new()));
    }

    proptest! {
        #[test]
        fn any_text_survives(entries in proptest::collection::vec(("[a-z=\\\\\n ]{0,6}", ".{0,9}|[=\\\\\n ]{0,5}"), 0..5)) {
            let mut identity = Identity::new();
            for (key, value) in &entries {
                identity.push(key.as_str(), value);
            }
            prop_assert_eq!(Identity::from_text(&identity.to_text()), Ok(identity));
        }

        #[test]
        fn equal_means_no_differences(a in proptest::collection::vec(("[ab]", "[01]"), 0..4), b in proptest::collection::vec(("[ab]", "[01]"), 0..4)) {
            let (a, b) = (Identity(a), Identity(b));
            prop_assert_eq!(a == b, a.differences(&b).is_empty());
            prop_assert_eq!(a == b, a.hash() == b.hash());
        }
    }
}
