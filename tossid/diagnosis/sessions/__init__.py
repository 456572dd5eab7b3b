"""Diagnosis over the order of recording: effects that are not the same in all tosses.

`values` has what each toss alone says of an effect. `changes` finds which effect changes over the order, where and by
how much. `correction` undoes errors of the recording toss by toss. `explained` puts a diagnosis together from these.
"""
