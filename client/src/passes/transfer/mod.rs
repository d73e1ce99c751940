//! Light that objects with bakes of their own give and take: their parts' radiance in place of what these hide (METHOD.md §2.17).

pub mod reference;
