//! Is it a door? From names alone, the way people and BIM exporters write them.

/// Words that make a name with "door" in it something else: what stays in the wall when the leaf is
/// taken off, and what has doors but leads nowhere.
const NOT_A_DOOR: [&str; 24] = [
    "frame",
    "framing",
    "casing",
    "jamb",
    "lintel",
    "threshold",
    "sill",
    "trim",
    "architrave",
    "lining",
    "stop",
    "mat",
    "bell",
    "wall",
    "opening",
    "hole",
    "way",
    "cabinet",
    "cupboard",
    "wardrobe",
    "oven",
    "fridge",
    "refrigerator",
    "dishwasher",
];

/// Words of a name, lower case: split at everything that is no letter, and where `camelCase` turns.
fn name_words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut before_lower = false;
    for c in name.chars() {
        if !c.is_alphabetic() || (c.is_uppercase() && before_lower) {
            words.push(String::new());
        }
        before_lower = c.is_lowercase();
        if c.is_alphabetic()
            && let Some(word) = words.last_mut()
        {
            word.extend(c.to_lowercase());
        }
    }
    words.retain(|w| !w.is_empty());
    words
}

/// True if an object, group or mesh of this name is a door that can be taken away.
///
/// A name whose IFC type says so decides alone (`IfcDoor`, `IfcDoorStandardCase`, ...: yes; any other
/// `Ifc...` but a proxy: no). Else the word `door` or `doors` does, unless the name also has a word
/// for what stays (`frame`, `casing`, ...) or for furniture. `doorway`, `outdoor` and `indoor` are
/// other words.
pub(crate) fn is_door(name: &str) -> bool {
    for segment in name.split(|c: char| !c.is_ascii_alphanumeric()) {
        let lower = segment.to_ascii_lowercase();
        if ["ifcdoor", "ifcdoorstandardcase", "ifcdoortype", "ifcdoorstyle"]
            .contains(&lower.as_str())
        {
            return true;
        }
        if segment.starts_with("Ifc")
            && segment.len() > 3
            && !lower.starts_with("ifcbuildingelementproxy")
        {
            return false;
        }
    }
    let words = name_words(name);
    let door = words.iter().enumerate().any(|(i, w)| {
        matches!(w.as_str(), "door" | "doors" | "doorleaf" | "doorpanel")
            && !(i > 0 && matches!(words[i - 1].as_str(), "in" | "out"))
    });
    door && !words.iter().any(|w| NOT_A_DOOR.contains(&w.as_str()))
}

#[cfg(test)]
mod tests {
    use super::is_door;

    #[test]
    fn door_words() {
        for yes in [
            "door",
            "Door_01",
            "door.003",
            "FrontDoor",
            "front door leaf",
            "Mesh/0012/SlidingDoors",
            "DOOR-7",
            "doors",
            "door7",
            "IfcDoor/2NHD__8fb3ZexljM_wSStT/M_Curtain_Wall_Dbl",
            "IfcDoorStandardCase/x/y",
            "IfcDoor/1/Frame",
            "IfcBuildingElementProxy/1/Door",
            "porch/door_handle",
        ] {
            assert!(is_door(yes), "{yes}");
        }
        for no in [
            "doorway",
            "Doorway_2",
            "outdoor",
            "indoor pool",
            "OutDoorBench",
            "InDoor",
            "doorframe",
            "door_frame",
            "DoorCasing",
            "door stop",
            "IfcWallStandardCase/1/wall with door",
            "IfcFurnishingElement/1/cabinet door",
            "IfcOpeningElement/2/Door",
            "cupboard_door_left",
            "wall_door_2",
            "ardooris",
            "chair",
            "",
            "matador",
        ] {
            assert!(!is_door(no), "{no}");
        }
    }
}
