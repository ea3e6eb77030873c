# Compiles one #include of each other layer with the include folders of LAYER; SEES must pass, LACKS must fail.
cmake_minimum_required(VERSION 3.25)

# compiles(header result): whether a file of this layer may include `header`.
function(compiles header result)
    file(MAKE_DIRECTORY ${WORK})
    file(WRITE ${WORK}/snippet.cpp "#include \"${header}\"\n")
    set(flags)
    # The compiler knows /usr/include; named once more, it hides <stdlib.h> from <cstdlib>.
    list(REMOVE_ITEM INCLUDES /usr/include)
    foreach(folder ${INCLUDES})
        list(APPEND flags -I${folder})
    endforeach()
    # -E: whether the file is found is the whole question.
    execute_process(
        COMMAND ${COMPILER} -std=c++20 ${flags} -E -o ${WORK}/snippet.ii ${WORK}/snippet.cpp
        RESULT_VARIABLE status
        ERROR_VARIABLE messages
        OUTPUT_QUIET)
    # Only "file not found" is the refusal that is meant; another error would hide a hole.
    if(NOT status EQUAL 0 AND NOT messages MATCHES "${header}: No such file|'${header}' file not found")
        message(FATAL_ERROR "${LAYER}: including ${header} failed for another reason:\n${messages}")
    endif()
    if(status EQUAL 0)
        set(${result} TRUE PARENT_SCOPE)
    else()
        set(${result} FALSE PARENT_SCOPE)
    endif()
endfunction()

foreach(layer ${SEES} ${LACKS})
    if(layer STREQUAL "proto")
        set(headers proto/dataset.pb.h)
    else()
        file(GLOB headers RELATIVE ${SOURCE} ${SOURCE}/${layer}/*.h)
    endif()
    if(NOT headers)
        message(STATUS "${layer} has no header yet")
        continue()
    endif()
    list(GET headers 0 header)
    compiles(${header} found)
    if(layer IN_LIST SEES AND NOT found)
        message(FATAL_ERROR "${LAYER} does not find ${header}")
    elseif(layer IN_LIST LACKS AND found)
        message(FATAL_ERROR "${LAYER} can include ${header}: look for a target it should not link")
    endif()
endforeach()
