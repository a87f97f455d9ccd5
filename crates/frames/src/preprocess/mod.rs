//! Pictures, depth and masks made ready: rectification, resizing, field-of-view and specular masks.
