//! What does the robot really drive? A smooth curve through the free space around a way, with a time law.

pub mod timing;
