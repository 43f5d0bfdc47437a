"""Parts of several commands, and helpers of one."""
