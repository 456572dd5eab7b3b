"""Contact in one step: the problem and its rows, the law at a corner, impacts, round corners, what contact holds."""
