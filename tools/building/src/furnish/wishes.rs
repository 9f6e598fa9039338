//! What each use of a room asks for, as names of the catalogue.

use crate::storey::Use;

/// What a use asks for: first these once each, then those in turn until it is enough.
pub(crate) fn list(use_: Use) -> (&'static [&'static str], &'static [&'static str]) {
    match use_ {
        Use::Office => (
            &["island", "bookcase", "picture", "ficus"],
            &[
                "bookcase",
                "workplace",
                "bookcase",
                "palm",
                "island",
                "sideboard",
                "picture",
                "ficus",
                "coats",
                "low-bookcase",
                "basket",
                "vitrine",
                "narrow-bookcase",
                "narrow-vitrine",
            ],
        ),
        Use::Meeting => (
            &["conference-8", "whiteboard", "meeting-round", "sideboard", "picture"],
            &[
                "meeting-round",
                "bookcase",
                "ficus",
                "television",
                "palm",
                "sideboard",
                "armchair",
                "picture",
                "vitrine",
                "narrow-bookcase",
                "narrow-vitrine",
            ],
        ),
        Use::Lounge => (
            &["lounge", "bookcase", "picture", "ficus"],
            &[
                "bookcase",
                "sofa",
                "lounge",
                "palm",
                "cafe",
                "chandelier",
                "armchair",
                "sideboard",
                "ficus",
                "picture",
                "vitrine",
                "narrow-bookcase",
                "narrow-vitrine",
            ],
        ),
        Use::Bedroom => (
            &["bed", "wardrobe", "workplace", "picture"],
            &[
                "sofa",
                "lounge-chair",
                "bookcase",
                "palm",
                "clothes",
                "mirror",
                "ficus",
                "armchair",
                "sideboard",
                "picture",
                "cafe",
                "chandelier",
                "coats",
                "vitrine",
                "bookcase",
                "narrow-bookcase",
                "narrow-vitrine",
            ],
        ),
        Use::Bath => (
            &["bathtub", "washplace", "toilet", "towels"],
            &[
                "snake-plant",
                "towels",
                "washplace",
                "washing-machine",
                "palm",
                "basket",
                "ficus",
                "narrow-vitrine",
            ],
        ),
        Use::Washroom => (
            &["washplace", "toilet", "toilet", "washplace", "towels", "washplace", "toilet"],
            &[
                "washplace",
                "toilet",
                "towels",
                "palm",
                "basket",
                "mirror",
                "clothes",
                "ficus",
                "narrow-vitrine",
            ],
        ),
        Use::Kitchen => (
            &["kitchen", "fridge", "dining"],
            &[
                "kitchen",
                "dining",
                "sideboard",
                "ficus",
                "cafe",
                "clock",
                "basket",
                "palm",
                "vitrine",
            ],
        ),
        Use::Store => (
            &["rack", "rack", "carton"],
            &[
                "rack",
                "carton",
                "rack",
                "short-rack",
                "clothes",
                "mop",
                "bookcase",
                "carton",
                "narrow-bookcase",
                "vitrine",
                "palm",
            ],
        ),
        Use::Stair => (&["picture"], &["ficus", "palm", "picture", "snake-plant"]),
        Use::Corridor => (
            &["picture", "bench"],
            &[
                "low-bookcase",
                "picture",
                "ficus",
                "bench",
                "palm",
                "bookcase",
                "mirror",
                "clock",
                "vitrine",
            ],
        ),
        Use::Lift => (
            &["lift", "lift", "lift", "lift", "palm"],
            &["ficus", "bench", "picture", "palm", "mirror", "vitrine"],
        ),
        Use::Library => (
            &["reading", "stack", "chandelier"],
            &[
                "stack",
                "bookcase",
                "stack",
                "reading",
                "bookcase",
                "stack",
                "lounge",
                "ficus",
                "bookcase",
                "narrow-bookcase",
                "vitrine",
            ],
        ),
        Use::Auditorium => (
            &["whiteboard", "piano"],
            &["palm", "bookcase", "ficus", "picture", "sideboard", "sofa", "vitrine"],
        ),
        Use::Restaurant => (
            &["buffet", "cafe", "cafe", "dining", "cafe", "picture", "cafe"],
            &[
                "cafe",
                "dining",
                "cafe",
                "cafe",
                "ficus",
                "sideboard",
                "cafe",
                "palm",
                "chandelier",
                "buffet",
                "vitrine",
            ],
        ),
        Use::Studio => (
            &["workbench", "easel", "easel", "rack"],
            &[
                "workbench",
                "bookcase",
                "easel",
                "workplace",
                "ficus",
                "rack",
                "lounge",
                "picture",
                "vitrine",
                "narrow-bookcase",
                "narrow-vitrine",
            ],
        ),
        Use::Lobby => (
            &["buffet", "lounge", "palm"],
            &[
                "ficus",
                "lounge",
                "palm",
                "sofa",
                "picture",
                "cafe",
                "sideboard",
                "bookcase",
                "vitrine",
            ],
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::furnish::catalogue::find;

    #[test]
    fn every_wish_is_in_the_catalogue() {
        use Use::{
            Auditorium, Bath, Bedroom, Corridor, Kitchen, Library, Lift, Lobby, Lounge, Meeting,
            Office, Restaurant, Stair, Store, Studio, Washroom,
        };
        for use_ in [
            Auditorium, Bath, Bedroom, Corridor, Kitchen, Library, Lift, Lobby, Lounge, Meeting,
            Office, Restaurant, Stair, Store, Studio, Washroom,
        ] {
            let (first, more) = list(use_);
            for name in first.iter().chain(more) {
                assert!(find(name).is_some(), "{use_:?}: {name}");
            }
        }
    }
}
