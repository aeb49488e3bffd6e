//! Makes small glTF files.
